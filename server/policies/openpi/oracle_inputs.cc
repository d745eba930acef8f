#include "server/policies/openpi/oracle_inputs.h"

#include <torch/types.h>

#include <algorithm>
#include <iterator>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "server/policies/openpi/problem_list.h"
#include "server/policies/tensor_io.h"

namespace robostress::openpi {
namespace {

constexpr char kImage[] = "inputs/image.", kImageMask[] = "inputs/image_mask.";
constexpr const char* kCameraOrder[] = {"base_0_rgb", "left_wrist_0_rgb", "right_wrist_0_rgb"};
constexpr double kMaxAttention = 1 << 28;  // elements of one attention matrix, 1 GiB

// Reads inputs one by one and keeps what is wrong with each.
class InputReader {
 public:
  explicit InputReader(const SafetensorsFile& file) : file_(file) {}

  int64_t batch() const { return batch_; }
  // The batch of all that follows is the first extent of `name`.
  void TakeBatch(const std::string& name) {
    const auto found = file_.tensors().find(name);
    if (found != file_.tensors().end() && !found->second.shape.empty())
      batch_ = found->second.shape[0];
    if (batch_ < 1) Complain(name, "is missing or empty, must be [batch, tokens]");
  }

  // [batch, shape...] of finite floats.
  torch::Tensor Floats(const std::string& name, std::vector<int64_t> shape) {
    const TensorView* view = Find(name, std::move(shape));
    return view == nullptr ? torch::Tensor() : Take(ToFiniteFloats(Where(name), *view));
  }
  torch::Tensor Bools(const std::string& name, std::vector<int64_t> shape) {
    return Typed(name, std::move(shape), DType::kBool);
  }
  // Integers in [0, limit).
  torch::Tensor Indices(const std::string& name, std::vector<int64_t> shape, int64_t limit) {
    torch::Tensor indices = Typed(name, std::move(shape), DType::kI64);
    if (!indices.defined() || indices.numel() == 0) return indices;
    for (const int64_t extreme : {indices.min().item<int64_t>(), indices.max().item<int64_t>()}) {
      if (extreme < 0 || extreme >= limit) {
        Complain(name, absl::StrCat("holds ", extreme, ", must be in 0..", limit - 1));
        return {};
      }
    }
    return indices;
  }
  bool Has(const std::string& name) const { return file_.tensors().contains(name); }

  void Complain(const std::string& name, const std::string& what) {
    problems_.push_back(absl::StrCat(name, " ", what));
  }
  absl::Status status() const {
    return ProblemList(file_.path(), "its inputs do not fit the network", problems_,
                       "Give the io file that was made with these weights");
  }

 private:
  std::string Where(const std::string& name) const { return absl::StrCat("tensor '", name, "'"); }

  const TensorView* Find(const std::string& name, std::vector<int64_t> shape) {
    shape.insert(shape.begin(), batch_);
    const auto found = file_.tensors().find(name);
    if (found == file_.tensors().end()) {
      Complain(name, absl::StrCat("is missing, must be ", ShapeText(shape)));
      return nullptr;
    }
    if (found->second.shape != shape) {
      Complain(name, absl::StrCat("has shape ", ShapeText(found->second.shape), ", must be ",
                                  ShapeText(shape)));
      return nullptr;
    }
    return &found->second;
  }

  torch::Tensor Typed(const std::string& name, std::vector<int64_t> shape, DType dtype) {
    const TensorView* view = Find(name, std::move(shape));
    if (view == nullptr) return {};
    if (view->dtype != dtype) {
      Complain(name, absl::StrCat("is ", DTypeName(view->dtype), ", must be ", DTypeName(dtype)));
      return {};
    }
    return Take(ToTensor(Where(name), *view));
  }

  torch::Tensor Take(absl::StatusOr<torch::Tensor> tensor) {
    if (tensor.ok()) return *std::move(tensor);
    problems_.push_back(std::string(tensor.status().message()));
    return {};
  }

  const SafetensorsFile& file_;
  int64_t batch_ = 0;
  std::vector<std::string> problems_;
};

// Cameras that have an image or a mask, in the order of their tokens.
std::vector<std::string> CamerasOf(const SafetensorsFile& file) {
  std::vector<std::string> cameras;
  for (const auto& [name, view] : file.tensors()) {
    absl::string_view camera = name;
    if (absl::ConsumePrefix(&camera, kImage) || absl::ConsumePrefix(&camera, kImageMask))
      cameras.emplace_back(camera);
  }
  const auto rank = [](const std::string& camera) {
    const auto* known = std::find(std::begin(kCameraOrder), std::end(kCameraOrder), camera);
    return std::make_pair(known - std::begin(kCameraOrder), camera);
  };
  std::sort(cameras.begin(), cameras.end(),
            [&](const std::string& a, const std::string& b) { return rank(a) < rank(b); });
  cameras.erase(std::unique(cameras.begin(), cameras.end()), cameras.end());
  return cameras;
}

// Memory that shapes alone would cost: attention grows with the square of the tokens.
void CheckAttention(const OpenpiConfig& c, size_t cameras, InputReader& reader) {
  const double batch = reader.batch();
  const double tokens =
      static_cast<double>(cameras) * c.patches() + c.prompt_tokens + c.suffix_tokens();
  const double joint = batch * c.heads * tokens * tokens;
  const double vision = batch * c.vision_heads * c.patches() * c.patches();
  if (std::max(joint, vision) <= kMaxAttention) return;
  reader.Complain("inputs",
                  absl::StrCat("would need attention matrices of ", std::max(joint, vision),
                               " elements for batch ", batch, " and ", tokens,
                               " tokens, the limit is ", kMaxAttention, "; use a smaller batch"));
}

}  // namespace

absl::StatusOr<OracleInputs> LoadOracleInputs(const SafetensorsFile& file, const OpenpiConfig& c) {
  InputReader reader(file);
  OracleInputs inputs;
  reader.TakeBatch("inputs/tokens");
  inputs.cameras = CamerasOf(file);
  CheckAttention(c, inputs.cameras.size(), reader);
  if (absl::Status status = reader.status(); !status.ok()) return status;
  if (inputs.cameras.empty()) reader.Complain("inputs/image.*", "are missing: no camera");
  for (const std::string& camera : inputs.cameras) {
    inputs.model.images.push_back(reader.Floats(kImage + camera, {3, c.image, c.image}));
    inputs.model.image_masks.push_back(reader.Bools(kImageMask + camera, {}));
  }
  inputs.model.tokens = reader.Indices("inputs/tokens", {c.prompt_tokens}, c.vocab);
  inputs.model.token_mask = reader.Bools("inputs/token_mask", {c.prompt_tokens});
  if (!c.pi05 || reader.Has("inputs/state"))
    inputs.model.state = reader.Floats("inputs/state", {c.action_dim});
  inputs.noise = reader.Floats("inputs/noise", {c.horizon, c.action_dim});
  if (reader.Has("inputs/loss.actions") || reader.Has("inputs/loss.noise") ||
      reader.Has("inputs/loss.time")) {
    inputs.loss_actions = reader.Floats("inputs/loss.actions", {c.horizon, c.action_dim});
    inputs.loss_noise = reader.Floats("inputs/loss.noise", {c.horizon, c.action_dim});
    inputs.loss_time = reader.Floats("inputs/loss.time", {});
  }
  if (absl::Status status = reader.status(); !status.ok()) return status;
  return inputs;
}

}  // namespace robostress::openpi
