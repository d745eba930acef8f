#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/lerobot/lerobot_dataset.h"
#include "common/status_macros.h"
#include "python/library/boundary.h"
#include "python/library/robostress.h"

struct robostress_dataset {
  robostress::LerobotSchema schema;
  robostress::LerobotDataset set;
};

namespace robostress {
namespace {

constexpr size_t kMostNames = 1000, kMostSteps = 1'000'000;
constexpr int kMostSide = 4096;

absl::Status CheckCount(const char* name, size_t count, size_t most) {
  if (count <= most) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(name, " is ", count, ", must be at most ", most));
}

absl::Status ReadNames(const char* field, const char* const* names, size_t count,
                       std::vector<std::string>& result) {
  RS_RETURN_IF_ERROR(CheckCount(field, count, kMostNames));
  if (count > 0) RS_RETURN_IF_ERROR(CheckHandle(field, names));
  for (size_t i = 0; i < count; ++i) {
    RS_RETURN_IF_ERROR(CheckHandle(field, names[i]));
    result.emplace_back(names[i]);
  }
  return absl::OkStatus();
}

absl::StatusOr<LerobotSchema> ReadSchema(const robostress_schema* given) {
  robostress_schema fields = {};
  RS_RETURN_IF_ERROR(ReadStructure("schema", given, fields));
  RS_RETURN_IF_ERROR(CheckHandle("schema.robot", fields.robot));
  LerobotSchema schema{fields.robot, fields.rate, {}, {}};
  std::vector<std::string> names;
  RS_RETURN_IF_ERROR(ReadNames("schema.vector_names", fields.vector_names, fields.vectors, names));
  if (!names.empty()) {
    RS_RETURN_IF_ERROR(CheckHandle("schema.axis_counts", fields.axis_counts));
    RS_RETURN_IF_ERROR(CheckHandle("schema.axis_names", fields.axis_names));
  }
  for (size_t i = 0; i < names.size(); ++i) {
    LerobotSchema::Vector& vector = schema.vectors.emplace_back();
    vector.name = names[i];
    RS_RETURN_IF_ERROR(
        ReadNames("schema.axis_names", fields.axis_names[i], fields.axis_counts[i], vector.axes));
  }
  RS_RETURN_IF_ERROR(
      ReadNames("schema.camera_names", fields.camera_names, fields.cameras, schema.cameras));
  return schema;
}

absl::Status ReadVectors(const robostress_frames& given, const LerobotSchema& schema,
                         LerobotEpisode& episode) {
  if (!schema.vectors.empty()) RS_RETURN_IF_ERROR(CheckHandle("frames.vectors", given.vectors));
  for (size_t i = 0; i < schema.vectors.size(); ++i) {
    const auto& [name, axes] = schema.vectors[i];
    RS_RETURN_IF_ERROR(CheckHandle("frames.vectors", given.vectors[i]));
    const float* from = given.vectors[i];
    episode.vectors.emplace_back(from, from + given.steps * axes.size());
    for (const float v : episode.vectors.back()) {
      if (!std::isfinite(v)) {
        return absl::InvalidArgumentError(
            absl::StrCat("feature ", name, " holds ", v, ", must be finite numbers"));
      }
    }
  }
  return absl::OkStatus();
}

absl::Status ReadPictures(const robostress_frames& given, const LerobotSchema& schema,
                          LerobotEpisode& episode) {
  if (schema.cameras.empty()) return absl::OkStatus();
  for (const void* field :
       {static_cast<const void*>(given.pixels), static_cast<const void*>(given.width),
        static_cast<const void*>(given.height), static_cast<const void*>(given.pictures),
        static_cast<const void*>(given.picture_ends)})
    RS_RETURN_IF_ERROR(CheckHandle("a field of frames for pictures", field));
  for (size_t c = 0; c < schema.cameras.size(); ++c) {
    const int width = given.width[c], height = given.height[c];
    if (width < 1 || width > kMostSide || height < 1 || height > kMostSide) {
      return absl::InvalidArgumentError(absl::StrCat("camera '", schema.cameras[c], "' is ", width,
                                                     " x ", height, " pixels, must be 1 to ",
                                                     kMostSide, " a side"));
    }
    RS_RETURN_IF_ERROR(CheckHandle("frames.pixels", given.pixels[c]));
    RS_RETURN_IF_ERROR(CheckHandle("frames.pictures", given.pictures[c]));
    RS_RETURN_IF_ERROR(CheckHandle("frames.picture_ends", given.picture_ends[c]));
    episode.width.push_back(width);
    episode.height.push_back(height);
    std::vector<Image>& small = episode.small.emplace_back();
    std::vector<std::string>& pictures = episode.pictures.emplace_back();
    const size_t bytes = size_t{3} * static_cast<size_t>(width) * static_cast<size_t>(height);
    size_t begin = 0;
    for (size_t i = 0; i < given.steps; ++i) {
      const unsigned char* pixels = given.pixels[c] + i * bytes;
      small.push_back({width, height, {pixels, pixels + bytes}});
      const size_t end = given.picture_ends[c][i];
      if (end < begin) {
        return absl::InvalidArgumentError(absl::StrCat("camera '", schema.cameras[c], "': picture ",
                                                       i, " ends at ", end, ", before ", begin));
      }
      pictures.emplace_back(reinterpret_cast<const char*>(given.pictures[c]) + begin, end - begin);
      begin = end;
    }
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress

extern "C" {

robostress_code robostress_dataset_open(const char* folder, const robostress_schema* schema,
                                        robostress_dataset** opened, char* error,
                                        size_t error_size) {
  return robostress::AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(robostress::CheckHandle("folder", folder));
    RS_RETURN_IF_ERROR(robostress::CheckHandle("opened", opened));
    RS_ASSIGN_OR_RETURN(robostress::LerobotSchema read, robostress::ReadSchema(schema));
    RS_ASSIGN_OR_RETURN(robostress::LerobotDataset set,
                        robostress::LerobotDataset::Open(folder, read));
    *opened = new robostress_dataset{std::move(read), std::move(set)};
    return absl::OkStatus();
  });
}

robostress_code robostress_dataset_append(robostress_dataset* dataset,
                                          const robostress_frames* frames, char* error,
                                          size_t error_size) {
  return robostress::AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(robostress::CheckHandle("dataset", dataset));
    robostress_frames given = {};
    RS_RETURN_IF_ERROR(robostress::ReadStructure("frames", frames, given));
    RS_RETURN_IF_ERROR(robostress::CheckHandle("frames.instruction", given.instruction));
    RS_RETURN_IF_ERROR(robostress::CheckCount("frames.steps", given.steps, robostress::kMostSteps));
    robostress::LerobotEpisode episode;
    episode.instruction = given.instruction;
    episode.success = given.success != 0;
    episode.steps = given.steps;
    RS_RETURN_IF_ERROR(robostress::ReadVectors(given, dataset->schema, episode));
    RS_RETURN_IF_ERROR(robostress::ReadPictures(given, dataset->schema, episode));
    return dataset->set.Append(episode);
  });
}

size_t robostress_dataset_episodes(const robostress_dataset* dataset) {
  return dataset == nullptr ? 0 : static_cast<size_t>(dataset->set.episodes());
}

size_t robostress_dataset_steps(const robostress_dataset* dataset) {
  return dataset == nullptr ? 0 : static_cast<size_t>(dataset->set.frames());
}

void robostress_dataset_free(robostress_dataset* dataset) { delete dataset; }

}  // extern "C"
