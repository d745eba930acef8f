#include "common/rpc/convert_observations.h"

#include "absl/strings/str_cat.h"
#include "common/rollout/field_checks.h"
#include "common/rollout/message_limits.h"
#include "common/status_macros.h"

namespace robostress {

robostress::v1::Observation ToProto(const Observation& observation) {
  v1::Observation message;
  message.set_instruction(observation.instruction);
  for (const CameraView& view : observation.views) {
    v1::CameraView* out = message.add_views();
    out->set_camera(view.camera);
    out->mutable_image()->set_width(static_cast<uint32_t>(view.image.width));
    out->mutable_image()->set_height(static_cast<uint32_t>(view.image.height));
    out->mutable_image()->set_data(view.image.data.data(), view.image.data.size());
  }
  message.mutable_proprioception()->Add(
      observation.proprioception.data(),
      observation.proprioception.data() + observation.proprioception.size());
  return message;
}

absl::StatusOr<Observation> FromProto(const robostress::v1::Observation& message) {
  RS_RETURN_IF_ERROR(
      CheckText("observation.instruction", message.instruction(), WireLimits::kInstruction));
  RS_RETURN_IF_ERROR(
      CheckRange("observation.views size", message.views_size(), 0, WireLimits::kViews));
  RS_RETURN_IF_ERROR(CheckRange("observation.proprioception size", message.proprioception_size(), 0,
                                WireLimits::kStateDim));
  Observation observation;
  observation.instruction = message.instruction();
  for (const v1::CameraView& view : message.views()) {
    RS_RETURN_IF_ERROR(CheckName("observation.views.camera", view.camera()));
    const v1::Image& image = view.image();
    RS_RETURN_IF_ERROR(
        CheckRange("observation.views.image.width", image.width(), 1, WireLimits::kImageSide));
    RS_RETURN_IF_ERROR(
        CheckRange("observation.views.image.height", image.height(), 1, WireLimits::kImageSide));
    const size_t expected = size_t{3} * image.width() * image.height();
    if (image.data().size() != expected) {
      return Invalid("view '", view.camera(), "' has ", image.data().size(),
                     " bytes of image data, ", image.width(), " x ", image.height(), " RGB needs ",
                     expected);
    }
    CameraView& out = observation.views.emplace_back();
    out.camera = view.camera();
    out.image.width = static_cast<int>(image.width());
    out.image.height = static_cast<int>(image.height());
    out.image.data.assign(image.data().begin(), image.data().end());
  }
  observation.proprioception.resize(message.proprioception_size());
  for (int i = 0; i < message.proprioception_size(); ++i) {
    RS_RETURN_IF_ERROR(CheckFinite(absl::StrCat("observation.proprioception[", i, "]"),
                                   message.proprioception(i)));
    observation.proprioception[i] = message.proprioception(i);
  }
  return observation;
}

}  // namespace robostress
