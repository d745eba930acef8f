// libero_pictures: our views beside those that originals/look.py took of LIBERO's own renderer.

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "sim_worker/libero/preprocess.h"
#include "tests/sim_worker/libero/picture_comparison.h"

namespace robostress::libero {
namespace {

struct CommandLine {
  std::string originals, site, out;
  bool options = false;
};

// Which tasks there are recordings of.
struct Recording {
  std::string name, file, suite;
  int task;
};
std::vector<Recording> RecordingsIn(const std::string& folder) {
  std::vector<Recording> found;
  for (const SuiteInfo& suite : AllSuites()) {
    for (int task = 0; suite.needs_libero && task < suite.num_tasks; ++task) {
      const std::string name = absl::StrCat(suite.name, "_", task);
      const std::string file = absl::StrCat(folder, "/", name, ".safetensors");
      if (std::filesystem::exists(file)) found.push_back({name, file, suite.name, task});
    }
  }
  return found;
}

// What each of the renderer's options is worth, and costs.
absl::Status PrintOptions(const CommandLine& line, const std::vector<Recording>& recordings) {
  const RenderOptions all = RenderAsLibero(256, 256);
  std::vector<std::pair<std::string, RenderOptions>> variants = {{"as the originals", all}};
  const auto without = [&](const char* name, auto change) {
    variants.emplace_back(name, all);
    change(variants.back().second);
  };
  without("no shadows", [](RenderOptions& o) { o.shadows = false; });
  without("shadow map of 1024 px", [](RenderOptions& o) { o.shadow_size = 1024; });
  without("no reflections", [](RenderOptions& o) { o.reflections = false; });
  without("one sample a pixel", [](RenderOptions& o) { o.samples = 0; });
  variants.emplace_back("none of them", RenderOptions{.width = 256, .height = 256});
  std::printf("| drawn | mean | 8 x 8 | CPU a view [ms] |\n|---|---:|---:|---:|\n");
  for (const auto& [name, options] : variants) {
    double mean = 0, block = 0;
    std::vector<double> times;
    for (const Recording& r : recordings) {
      RS_ASSIGN_OR_RETURN(const DrawnOtherwise drawn,
                          CompareDrawn(r.file, r.suite, r.task, line.site, options));
      mean += drawn.mean / static_cast<double>(recordings.size());
      block = std::max(block, drawn.block);
      times.push_back(drawn.cpu_s);
    }
    std::sort(times.begin(), times.end());
    std::printf("| %s | %.3f | %.1f | %.0f |\n", name.c_str(), mean, block,
                1e3 * times[times.size() / 2]);
    std::fflush(stdout);
  }
  return absl::OkStatus();
}

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
  const std::vector<Recording> recordings = RecordingsIn(line.originals);
  if (recordings.empty())
    return absl::NotFoundError(absl::StrCat(line.originals, ": no SUITE_TASK.safetensors there"));
  if (line.options) return PrintOptions(line, recordings);
  std::printf(
      "| task | mean | largest | visible | 8 x 8 | sent: mean | own way: mean | state | own way: "
      "state | fixtures |\n|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n");
  Worst all;
  for (const Recording& r : recordings) {
    RS_ASSIGN_OR_RETURN(const ComparedTask task, CompareTask(r.file, r.suite, r.task, line.site));
    Worst raw, sent, own;
    for (const ComparedPicture& picture : task.same_state) {
      (picture.ours.width == 256 ? raw : sent).Add(picture);
      if (picture.ours.width == 256) all.Add(picture);
    }
    for (const ComparedPicture& picture : task.whole_way) own.Add(picture);
    std::printf("| %s | %.3f | %d | %.2f %% | %.2f | %.3f | %.3f | %.1e | %.1e | %.1e |\n",
                r.name.c_str(), raw.difference.mean, raw.difference.largest,
                100 * raw.difference.visible, raw.difference.block, sent.difference.mean,
                own.difference.mean, task.start_proprioception,
                LargestOf(task.whole_way_proprioception), task.fixtures);
    for (const auto& [array, difference] : task.model_arrays) {
      if (difference > 1e-6)
        std::printf("  %s: %s differs by %.3g\n", r.name.c_str(), array.c_str(), difference);
    }
    std::fflush(stdout);
    if (line.out.empty()) continue;
    std::error_code ignored;
    std::filesystem::create_directories(line.out, ignored);
    RS_RETURN_IF_ERROR(WritePictures(line.out, r.name, task.same_state));
    RS_RETURN_IF_ERROR(WritePictures(line.out, "own_way." + r.name, task.whole_way));
  }
  std::printf("%zu tasks; worst mean %.3f (%s), largest %d, 8 x 8 %.2f\n", recordings.size(),
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
  app.add_flag("--options", line.options,
               "Instead: what shadows, reflections and samples are worth and cost");
  app.add_option("--out", line.out, "Folder for pictures: ours, theirs, 8 x the difference");
  return robostress::RunMain(app, argc, argv, [&] { return robostress::libero::Run(line); });
}
