#include "common/models/mesh_file.h"

#include <cstring>
#include <filesystem>
#include <system_error>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/models/collada.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

using Eigen::Vector3d;
using Corners = absl::StatusOr<std::vector<Vector3d>>;

constexpr uint64_t kMostBytes = 256 << 20;
constexpr size_t kMostTriangles = 2000000;
constexpr size_t kStlHeader = 84, kStlTriangle = 50;  // [bytes]

bool IsFile(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

std::string EndingOf(const std::string& path) {
  return absl::AsciiStrToLower(fs::path(path).extension().string());
}

absl::Status Refusal(const std::string& what) { return absl::InvalidArgumentError(what); }

// Three numbers from a place in a row of words.
bool PointOf(const std::vector<absl::string_view>& words, size_t first, Vector3d* point) {
  if (words.size() < first + 3) return false;
  for (size_t i = 0; i < 3; ++i)
    if (!absl::SimpleAtod(words[first + i], &(*point)[i])) return false;
  return true;
}

std::vector<absl::string_view> WordsOf(absl::string_view line) {
  return absl::StrSplit(line, absl::ByAnyChar(" \t\r"), absl::SkipEmpty());
}

Corners BinaryStl(const std::string& text) {
  uint32_t triangles = 0;
  std::memcpy(&triangles, text.data() + kStlHeader - sizeof triangles, sizeof triangles);
  const size_t needed = kStlHeader + kStlTriangle * static_cast<size_t>(triangles);
  if (text.size() < needed)
    return Refusal(absl::StrCat("is cut off: ", triangles, " triangles need ", needed,
                                " bytes, it has ", text.size()));
  if (triangles > kMostTriangles) return Refusal(absl::StrCat("has ", triangles, " triangles"));
  std::vector<Vector3d> corners;
  corners.reserve(3 * static_cast<size_t>(triangles));
  for (size_t at = kStlHeader; at < needed; at += kStlTriangle) {
    float numbers[12];  // the normal first
    std::memcpy(numbers, text.data() + at, sizeof numbers);
    for (int k = 3; k < 12; k += 3)
      corners.emplace_back(numbers[k], numbers[k + 1], numbers[k + 2]);
  }
  return corners;
}

Corners AsciiStl(const std::string& text) {
  std::vector<Vector3d> corners;
  bool ended = false;
  for (const absl::string_view line : absl::StrSplit(text, '\n')) {
    const std::vector<absl::string_view> words = WordsOf(line);
    if (words.empty()) continue;
    const std::string first = absl::AsciiStrToLower(words[0]);
    ended = first == "endsolid";
    if (first != "vertex") continue;
    if (!PointOf(words, 1, &corners.emplace_back()))
      return Refusal(absl::StrCat("'", line.substr(0, 60), "' is no corner"));
  }
  if (!ended || corners.size() % 3 != 0)
    return Refusal("is no whole STL: it does not end with endsolid, or is binary and cut off");
  return corners;
}

Corners Stl(const std::string& text) {
  uint32_t triangles = 0;
  if (text.size() >= kStlHeader)
    std::memcpy(&triangles, text.data() + kStlHeader - sizeof triangles, sizeof triangles);
  const bool exact = text.size() == kStlHeader + kStlTriangle * static_cast<size_t>(triangles);
  if (text.size() < kStlHeader || (!exact && absl::StartsWith(text, "solid")))
    return AsciiStl(text);
  return BinaryStl(text);
}

Corners Obj(const std::string& text) {
  std::vector<Vector3d> points, corners;
  for (const absl::string_view line : absl::StrSplit(text, '\n')) {
    const std::vector<absl::string_view> words = WordsOf(line);
    if (words.empty()) continue;
    const auto wrong = [&] {
      return Refusal(absl::StrCat("'", line.substr(0, 60),
                                  "' is no corner, or names one that is "
                                  "not there"));
    };
    if (words[0] == "v" && !PointOf(words, 1, &points.emplace_back())) return wrong();
    if (words[0] != "f") continue;
    std::vector<Vector3d> face;  // as a fan
    for (size_t i = 1; i < words.size(); ++i) {
      int64_t index = 0;  // from 1, or back from the last point
      if (!absl::SimpleAtoi(words[i].substr(0, words[i].find('/')), &index)) return wrong();
      index = index < 0 ? index + static_cast<int64_t>(points.size()) : index - 1;
      if (index < 0 || index >= static_cast<int64_t>(points.size())) return wrong();
      face.push_back(points[static_cast<size_t>(index)]);
    }
    for (size_t i = 2; i < face.size(); ++i)
      corners.insert(corners.end(), {face[0], face[i - 1], face[i]});
  }
  return corners;
}

}  // namespace

std::string FindMesh(const std::string& filename, const std::string& urdf,
                     const std::vector<std::string>& packages) {
  const fs::path folder = fs::path(urdf).parent_path();
  absl::string_view rest = filename;
  if (!absl::ConsumePrefix(&rest, "package://")) {
    absl::ConsumePrefix(&rest, "file://");
    const fs::path path = folder / std::string(rest);
    return IsFile(path) ? path.string() : "";
  }
  const size_t slash = rest.find('/');
  if (slash == absl::string_view::npos) return "";
  const std::string package(rest.substr(0, slash)), inside(rest.substr(slash + 1));
  const auto in = [&](const fs::path& where) -> std::string {
    for (const fs::path& path : {where / package / inside, where / inside})
      if (IsFile(path)) return path.lexically_normal().string();
    return "";
  };
  for (const std::string& where : packages)
    if (std::string found = in(where); !found.empty()) return found;
  std::error_code error;
  fs::path where = fs::weakly_canonical(fs::absolute(folder, error), error);
  for (; !where.empty(); where = where.parent_path()) {
    if (std::string found = in(where); !found.empty()) return found;
    if (where == where.root_path()) break;
  }
  return "";
}

bool IsMeshRead(const std::string& path) {
  const std::string ending = EndingOf(path);
  return ending == ".stl" || ending == ".obj" || ending == ".dae";
}

Corners ReadMesh(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMostBytes));
  return ParseMesh(path, text);
}

Corners ParseMesh(const std::string& path, const std::string& text) {
  const std::string ending = EndingOf(path);
  const auto refusal = [&](absl::string_view why) {
    return Refusal(absl::StrCat(absl::StartsWith(why, path) ? "" : absl::StrCat(path, ": "), why,
                                "; put the whole file there, or take the mesh out of the model"));
  };
  Corners corners = ending == ".stl"   ? Stl(text)
                    : ending == ".obj" ? Obj(text)
                                       : ReadCollada(path, text, kMostTriangles);
  if (!corners.ok()) return refusal(corners.status().message());
  if (corners->empty()) return refusal("has no triangles");
  if (corners->size() > 3 * kMostTriangles)
    return refusal(absl::StrCat("has more than ", kMostTriangles, " triangles"));
  for (const Vector3d& corner : *corners)
    if (!corner.allFinite()) return refusal("a corner is no number");
  return corners;
}

}  // namespace robostress
