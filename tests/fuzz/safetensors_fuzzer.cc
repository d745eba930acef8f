// The reader of safetensors files: models, oracles, checkpoints, recordings.
#include "common/safetensors.h"
#include "tests/fuzz/fuzz_check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  const std::string name = "weights.safetensors";
  const absl::StatusOr<SafetensorsFile> file =
      SafetensorsFile::Parse(name, {reinterpret_cast<const char*>(data), size});
  if (!file.ok()) {
    CheckRefusal(file.status(), name);
    return 0;
  }
  SafetensorsWriter writer;
  for (const auto& [key, value] : file->metadata()) writer.SetMetadata(key, value);
  for (const auto& [key, view] : file->tensors()) {
    const auto values = file->ReadDoubles(key);
    FuzzCheck(values.ok(), "an accepted tensor cannot be read");
    FuzzCheck(static_cast<int64_t>(values->size()) == view.num_elements(), "lost elements");
    writer.Add(key, view.dtype, view.shape, view.bytes.data(), view.bytes.size());
  }
  const absl::StatusOr<std::string> written = writer.Serialize();
  FuzzCheck(written.ok(), "what was read cannot be written");
  const absl::StatusOr<SafetensorsFile> again = SafetensorsFile::Parse(name, *written);
  FuzzCheck(again.ok(), "what was written cannot be read");
  FuzzCheck(again->metadata() == file->metadata(), "the metadata changed");
  for (const auto& [key, view] : file->tensors()) {
    const absl::StatusOr<TensorView> copy = again->Get(key);
    FuzzCheck(copy.ok() && copy->shape == view.shape && copy->bytes == view.bytes,
              "a tensor changed");
  }
  return 0;
}
