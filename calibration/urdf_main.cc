// robostress-urdf: an MJCF model as URDF, for what reads no MJCF.

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "calibration/model/model_file.h"
#include "calibration/model/urdf_output.h"
#include "common/atomic_file.h"
#include "common/models/model_table.h"
#include "common/run_main.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress urdf franka_emika_panda/panda.xml --out panda.urdf\n"
    "  robostress urdf universal_robots_ur5e/ur5e.xml --out rigs/ur5e.urdf\n\n"
    "Meshes are written beside it, in the folder NAME_meshes. Frames, masses, inertias, limits "
    "and\n"
    "shapes are those that MuJoCo compiles; the table says what URDF has no word for.\n"
    "Exit code: 0 done; 1 writing failed; 2 the command or the model is wrong.\n";

constexpr uint64_t kMostBytes = 16 << 20;

struct CommandLine {
  std::string model, out;
};

namespace fs = std::filesystem;

absl::Status WriteAll(const UrdfOutput& urdf, const fs::path& out) {
  if (out.has_parent_path()) RS_RETURN_IF_ERROR(MakeDirectories(out.parent_path().string()));
  for (const auto& [name, bytes] : urdf.meshes) {
    const fs::path path = out.parent_path() / name;
    RS_RETURN_IF_ERROR(MakeDirectories(path.parent_path().string()));
    RS_RETURN_IF_ERROR(WriteFileAtomically(path.string(), bytes));
  }
  return WriteFileAtomically(out.string(), urdf.xml);
}

absl::Status Run(const CommandLine& line) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(line.model, kMostBytes));
  RS_ASSIGN_OR_RETURN(const XmlFile file, XmlFile::Parse(line.model, text));
  if (std::string(file.root().Name()) != "mujoco")
    return file.Error(file.root(), absl::StrCat("the root is <", file.root().Name(),
                                                ">, must be <mujoco>: MJCF"));
  RS_ASSIGN_OR_RETURN(const LoadedModel loaded, LoadMjcf(file));
  const fs::path out = line.out;
  std::error_code error;
  if (fs::equivalent(line.model, out, error))
    return absl::InvalidArgumentError(
        absl::StrCat("--out ", line.out, ": is the model itself; name another file"));
  const auto urdf = UrdfOf(*loaded.model, absl::StrCat(out.stem().string(), "_meshes"));
  if (!urdf.ok())
    return absl::InvalidArgumentError(absl::StrCat(line.model, ": ", urdf.status().message()));
  if (const absl::Status written = WriteAll(*urdf, out); !written.ok())
    return absl::UnavailableError(written.message());
  std::vector<ModelFact> facts = loaded.facts;
  facts.insert(facts.end(), urdf->facts.begin(), urdf->facts.end());
  std::printf("%s\n%s", line.model.c_str(), ModelTableText(facts, "  ").c_str());
  std::printf("%s: joints %s\n", line.out.c_str(), absl::StrJoin(urdf->joints, ", ").c_str());
  const bool site = !urdf->sites.empty();
  const std::vector<std::string>& frames = site ? urdf->sites : urdf->bodies;
  const auto named = std::find_first_of(frames.begin(), frames.end(), std::begin(kPayloadSites),
                                        std::end(kPayloadSites));
  std::printf("a tool's point can be the frame of any link%s: %s\n",
              site ? "; of sites" : ", the file has no site", absl::StrJoin(frames, ", ").c_str());
  std::printf("in a robot file: model: {file: %s, joints: [THE ARM'S], tool: %s}\n",
              out.filename().c_str(), named == frames.end() ? "ONE OF THEM" : named->c_str());
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CommandLine line;
  cli::App app("Writes an MJCF model as URDF, which robot_client and others read",
               "robostress urdf");
  app.footer(kExamples);
  app.add_option("model", line.model, "MJCF file")->required();
  app.add_option("--out", line.out, "URDF to write")->required();
  return RunMain(
      app, argc, argv, [&] { return Run(line); },
      [](const absl::Status& status) {
        return absl::IsInvalidArgument(status) || absl::IsNotFound(status) ? kWrongCommand
                                                                           : kFailed;
      });
}

}  // namespace
}  // namespace robostress::calibration

int main(int argc, char** argv) { return robostress::calibration::Main(argc, argv); }
