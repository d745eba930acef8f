#include "server/sessions/journal/session_events.h"

#include <google/protobuf/io/coded_stream.h>

#include <vector>

#include "absl/strings/str_cat.h"
#include "common/rpc/convert_chunks.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/sessions/journal/state_records.h"
#include "server/sessions/state_rules.h"

namespace robostress {
namespace {

// What stands before `size` bytes of a field that is text, bytes or a message.
std::string FieldHead(int number, uint64_t size) {
  uint8_t head[16];
  const auto tag = static_cast<uint32_t>(number) << 3 | 2;
  uint8_t* end = google::protobuf::io::CodedOutputStream::WriteVarint32ToArray(tag, head);
  end = google::protobuf::io::CodedOutputStream::WriteVarint64ToArray(size, end);
  return {head, end};
}

// Adds the views to a serialised prediction that lacks them. A message that comes in parts is one
// (protobuf merges them), and so the pixels are copied once.
void AppendViews(const Observation& observation, std::string& bytes) {
  size_t pixels = 0;
  for (const CameraView& view : observation.views) pixels += view.image.data.size() + 512;
  bytes.reserve(bytes.size() + pixels);
  for (const CameraView& view : observation.views) {
    const std::vector<uint8_t>& data = view.image.data;
    v1::CameraView message;
    message.set_camera(view.camera);
    const std::string camera = message.SerializeAsString();
    v1::Image image;
    image.set_width(static_cast<uint32_t>(view.image.width));
    image.set_height(static_cast<uint32_t>(view.image.height));
    // From the inside out.
    std::string head =
        image.SerializeAsString() + FieldHead(v1::Image::kDataFieldNumber, data.size());
    const auto wrap = [&](int number) {
      head.insert(0, FieldHead(number, head.size() + data.size()));
    };
    wrap(v1::CameraView::kImageFieldNumber);
    head.insert(0, camera);
    wrap(v1::Observation::kViewsFieldNumber);
    wrap(v1::StatePrediction::kObservationFieldNumber);
    wrap(v1::StateRecord::kPredictionFieldNumber);
    bytes.append(head).append(data.begin(), data.end());
  }
}

}  // namespace

std::string EncodeEvent(const Prediction& prediction) {
  v1::StateRecord record;
  *record.mutable_prediction() = ToRecord(prediction, /*with_views=*/false);
  std::string bytes = record.SerializeAsString();
  if (prediction.observation != nullptr) AppendViews(*prediction.observation, bytes);
  return bytes;
}

std::string EncodeEvent(const ExecutedChunk& executed) {
  v1::StateRecord record;
  *record.mutable_feedback()->mutable_chunk() = ToProto(executed);
  return record.SerializeAsString();
}

std::string EncodeEvent(const EpisodeStarted& started) {
  v1::StateRecord record;
  record.mutable_episode()->set_task(static_cast<uint32_t>(started.key.task));
  record.mutable_episode()->set_episode(static_cast<uint32_t>(started.key.episode));
  record.mutable_episode()->set_last_feedback_sequence(started.last_sequence);
  return record.SerializeAsString();
}

std::string EncodeEvent(const AdapterImported& imported) {
  v1::StateRecord record;
  record.mutable_imported()->set_safetensors(imported.safetensors);
  return record.SerializeAsString();
}

std::string EncodeEvent(const AdapterRolledBack& back) {
  v1::StateRecord record;
  record.mutable_rollback()->set_version(back.version);
  return record.SerializeAsString();
}

std::string EncodeEvent(const VersionPinned& pin) {
  v1::StateRecord record;
  record.mutable_pin()->set_version(pin.version);
  record.mutable_pin()->set_pinned(pin.pinned);
  return record.SerializeAsString();
}

absl::StatusOr<SessionEvent> DecodeEvent(const v1::StateRecord& record) {
  switch (record.record_case()) {
    case v1::StateRecord::kPrediction: {
      RS_ASSIGN_OR_RETURN(Prediction prediction, FromRecord(record.prediction()));
      return prediction;
    }
    case v1::StateRecord::kFeedback: {
      RS_ASSIGN_OR_RETURN(ExecutedChunk chunk, FromProto(record.feedback().chunk()));
      return chunk;
    }
    case v1::StateRecord::kEpisode: {
      const v1::StateEpisode& episode = record.episode();
      RS_RETURN_IF_ERROR(StateRules::CheckEpisode(episode.task(), episode.episode()));
      return EpisodeStarted{{static_cast<int>(episode.task()), static_cast<int>(episode.episode())},
                            episode.last_feedback_sequence()};
    }
    case v1::StateRecord::kImported:
      return AdapterImported{record.imported().safetensors()};
    case v1::StateRecord::kRollback:
      return AdapterRolledBack{record.rollback().version()};
    case v1::StateRecord::kPin:
      return VersionPinned{record.pin().version(), record.pin().pinned()};
    default:
      return absl::DataLossError(
          absl::StrCat("a record of kind ", record.record_case(), " does not belong in a journal"));
  }
}

}  // namespace robostress
