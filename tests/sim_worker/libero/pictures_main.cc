// libero_pictures: our views beside those that originals/look.py took of LIBERO's own renderer.

#include <cstdio>
#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "tests/sim_worker/libero/picture_comparison.h"

namespace robostress::libero {
namespace {

struct CommandLine {
  std::string originals, site, out;
};

// The worst of a task's pictures.
struct Worst {
  PictureDifference difference;
  std::string picture;

  void Add(const ComparedPicture& picture_in) {
    const PictureDifference& d = picture_in.difference;
    if (d.mean >= difference.mean)
      picture = absl::StrCat(picture_in.moment, " ", picture_in.camera);
    difference.mean = std::max(difference.mean, d.mean);
    difference.largest = std::max(difference.largest, d.largest);
    difference.visible = std::max(difference.visible, d.visible);
    difference.block = std::max(difference.block, d.block);
  }
};

double LargestOf(const std::map<std::string, double>& values) {
  double largest = 0;
  for (const auto& [name, value] : values) largest = std::max(largest, value);
  return largest;
}

absl::Status WritePictures(const std::string& folder, const std::string& task,
                           const std::vector<ComparedPicture>& pictures) {
  for (const ComparedPicture& picture : pictures) {
    RS_ASSIGN_OR_RETURN(const std::string png, EncodePng(Beside(picture.ours, picture.theirs)));
    RS_RETURN_IF_ERROR(WriteFileAtomically(
        absl::StrCat(folder, "/", task, ".", picture.moment, ".", picture.camera, ".png"), png));
  }
  return absl::OkStatus();
}

absl::Status Run(const CommandLine& line) {
  std::printf(
      "| task | mean | largest | visible | 8 x 8 | sent: mean | own way: mean | state | own way: "
      "state | fixtures |\n|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n");
  int count = 0;
  Worst all;
  for (const SuiteInfo& suite : AllSuites()) {
    for (int index = 0; suite.needs_libero && index < suite.num_tasks; ++index) {
      const std::string name = absl::StrCat(suite.name, "_", index);
      const std::string file = absl::StrCat(line.originals, "/", name, ".safetensors");
      if (!std::filesystem::exists(file)) continue;
      RS_ASSIGN_OR_RETURN(const ComparedTask task, CompareTask(file, suite.name, index, line.site));
      Worst raw, sent, own;
      for (const ComparedPicture& picture : task.same_state) {
        (picture.ours.width == 256 ? raw : sent).Add(picture);
        if (picture.ours.width == 256) all.Add(picture);
      }
      for (const ComparedPicture& picture : task.whole_way) own.Add(picture);
      std::printf("| %s | %.3f | %d | %.2f %% | %.2f | %.3f | %.3f | %.1e | %.1e | %.1e |\n",
                  name.c_str(), raw.difference.mean, raw.difference.largest,
                  100 * raw.difference.visible, raw.difference.block, sent.difference.mean,
                  own.difference.mean, LargestOf(task.same_state_proprioception),
                  LargestOf(task.whole_way_proprioception), task.fixtures);
      for (const auto& [array, difference] : task.model_arrays) {
        if (difference > 1e-6)
          std::printf("  %s: %s differs by %.3g\n", name.c_str(), array.c_str(), difference);
      }
      std::fflush(stdout);
      if (!line.out.empty()) {
        std::error_code ignored;
        std::filesystem::create_directories(line.out, ignored);
        RS_RETURN_IF_ERROR(WritePictures(line.out, name, task.same_state));
        RS_RETURN_IF_ERROR(WritePictures(line.out, "own_way." + name, task.whole_way));
      }
      ++count;
    }
  }
  if (count == 0)
    return absl::NotFoundError(absl::StrCat(line.originals, ": no SUITE_TASK.safetensors there"));
  std::printf("%d tasks; worst mean %.3f (%s), largest %d, 8 x 8 %.2f\n", count,
              all.difference.mean, all.picture.c_str(), all.difference.largest,
              all.difference.block);
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress::libero

int main(int argc, char** argv) {
  robostress::cli::App app("Compares our views with LIBERO's own.", "libero_pictures");
  robostress::libero::CommandLine line;
  app.add_option("--originals", line.originals, "Folder that look.py wrote")->required();
  app.add_option("--site", line.site, "site-packages of its environment")->required();
  app.add_option("--out", line.out, "Folder for pictures: ours, theirs, 8 x the difference");
  return robostress::RunMain(app, argc, argv, [&] { return robostress::libero::Run(line); });
}
