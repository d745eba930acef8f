#include "common/models/collada.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <type_traits>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/models/xml_file.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

using Eigen::Vector3d;
using tinyxml2::XMLElement;

constexpr int kDeepest = 32;  // of nodes in nodes: a file may name itself
constexpr int kMostNodes = 100000;

template <class T>
bool Parse(absl::string_view word, T* value) {
  if constexpr (std::is_floating_point_v<T>)
    return absl::SimpleAtod(word, value);
  else
    return absl::SimpleAtoi(word, value);
}

class Reader {
 public:
  Reader(const XmlFile& file, size_t most) : file_(file), most_(most) { Index(file.root(), 0); }

  absl::StatusOr<std::vector<Vector3d>> Read() {
    Eigen::Affine3d T = Eigen::Affine3d::Identity();
    if (const XMLElement* asset = file_.root().FirstChildElement("asset"); asset != nullptr) {
      if (const XMLElement* unit = asset->FirstChildElement("unit"); unit != nullptr) {
        RS_ASSIGN_OR_RETURN(const auto metres, file_.Numbers(*unit, "meter", {1}));
        if (!(metres[0] > 0)) return file_.Error(*unit, "meter must be above 0");
        T.scale(metres[0]);
      }
    }
    const XMLElement* scene = file_.root().FirstChildElement("scene");
    if (scene == nullptr) return file_.Error(file_.root(), "has no <scene>");
    RS_RETURN_IF_ERROR(Visit(*scene, T, 0));
    return std::move(corners_);
  }

 private:
  void Index(const XMLElement& e, int depth) {
    if (const std::string id = AttributeOf(e, "id"); !id.empty()) by_id_.emplace(id, &e);
    if (depth > kDeepest) return;
    for (const XMLElement* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement())
      Index(*c, depth + 1);
  }

  absl::StatusOr<const XMLElement*> Named(const XMLElement& e, const char* attribute) const {
    const std::string url = AttributeOf(e, attribute);
    const auto found = by_id_.find(std::string(absl::StripPrefix(url, "#")));
    if (found == by_id_.end())
      return file_.Error(e, absl::StrCat(attribute, "=\"", url, "\" is not in the file"));
    return found->second;
  }

  template <class T>
  absl::StatusOr<std::vector<T>> List(const XMLElement& e) const {
    std::vector<T> values;
    const char* text = e.GetText();
    if (text == nullptr) return values;
    for (const absl::string_view word :
         absl::StrSplit(text, absl::ByAnyChar(" \t\r\n"), absl::SkipEmpty())) {
      if (!Parse(word, &values.emplace_back()))
        return file_.Error(e, absl::StrCat("'", word.substr(0, 40), "' is no number"));
    }
    return values;
  }

  // What a node does to its children.
  absl::Status Place(const XMLElement& e, Eigen::Affine3d* T) const {
    const absl::string_view name = e.Name();
    const size_t numbers = name == "matrix"                         ? 16
                           : name == "rotate"                       ? 4
                           : name == "translate" || name == "scale" ? 3
                                                                    : 0;
    if (numbers == 0) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(const std::vector<double> v, List<double>(e));
    if (v.size() != numbers)
      return file_.Error(
          e, absl::StrCat("<", e.Name(), "> has ", v.size(), " numbers, must have ", numbers));
    if (name == "matrix") {
      Eigen::Affine3d here;
      here.matrix() = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(v.data());
      *T = *T * here;
    } else if (name == "rotate") {
      const Vector3d axis(v[0], v[1], v[2]);
      if (axis.norm() > 0) T->rotate(Eigen::AngleAxisd(v[3] * M_PI / 180, axis.normalized()));
    } else if (name == "translate") {
      T->translate(Vector3d(v[0], v[1], v[2]));
    } else {
      T->scale(Vector3d(v[0], v[1], v[2]));
    }
    return absl::OkStatus();
  }

  absl::Status Visit(const XMLElement& node, Eigen::Affine3d T, int depth) {
    if (depth > kDeepest || ++visited_ > kMostNodes)
      return file_.Error(node, "its nodes name each other in a circle, or are too many");
    for (const XMLElement* c = node.FirstChildElement(); c != nullptr;
         c = c->NextSiblingElement()) {
      const absl::string_view name = c->Name();
      RS_RETURN_IF_ERROR(Place(*c, &T));
      if (name == "node") RS_RETURN_IF_ERROR(Visit(*c, T, depth + 1));
      if (name == "instance_node" || name == "instance_visual_scene") {
        RS_ASSIGN_OR_RETURN(const XMLElement* named, Named(*c, "url"));
        RS_RETURN_IF_ERROR(Visit(*named, T, depth + 1));
      }
      if (name != "instance_geometry") continue;
      RS_ASSIGN_OR_RETURN(const XMLElement* geometry, Named(*c, "url"));
      if (const XMLElement* mesh = geometry->FirstChildElement("mesh"); mesh != nullptr)
        RS_RETURN_IF_ERROR(AddMesh(*mesh, T));
    }
    return absl::OkStatus();
  }

  // Where the input of the corners is among a primitive's indices; how many there are for each.
  struct Layout {
    const XMLElement* points = nullptr;  // the <vertices>' source
    size_t offset = 0, stride = 1;
  };
  absl::StatusOr<Layout> LayoutOf(const XMLElement& primitive) const {
    Layout layout;
    for (const XMLElement* input = primitive.FirstChildElement("input"); input != nullptr;
         input = input->NextSiblingElement("input")) {
      RS_ASSIGN_OR_RETURN(const auto offset, file_.Numbers(*input, "offset", {0}));
      if (!(offset[0] >= 0 && offset[0] < 64))
        return file_.Error(*input, "offset must be from 0 to 63");
      layout.stride = std::max(layout.stride, static_cast<size_t>(offset[0]) + 1);
      if (AttributeOf(*input, "semantic") != "VERTEX") continue;
      layout.offset = static_cast<size_t>(offset[0]);
      RS_ASSIGN_OR_RETURN(const XMLElement* vertices, Named(*input, "source"));
      for (const XMLElement* of = vertices->FirstChildElement("input"); of != nullptr;
           of = of->NextSiblingElement("input")) {
        if (AttributeOf(*of, "semantic") != "POSITION") continue;
        RS_ASSIGN_OR_RETURN(layout.points, Named(*of, "source"));
      }
    }
    if (layout.points == nullptr) return file_.Error(primitive, "has no corners");
    return layout;
  }

  absl::StatusOr<std::vector<Vector3d>> PointsOf(const XMLElement& source,
                                                 const Eigen::Affine3d& T) const {
    const XMLElement* array = source.FirstChildElement("float_array");
    if (array == nullptr) return file_.Error(source, "has no <float_array>");
    RS_ASSIGN_OR_RETURN(const std::vector<double> numbers, List<double>(*array));
    std::vector<Vector3d> points;
    for (size_t i = 0; i + 2 < numbers.size(); i += 3)
      points.push_back(T * Vector3d(numbers[i], numbers[i + 1], numbers[i + 2]));
    return points;
  }

  absl::Status AddMesh(const XMLElement& mesh, const Eigen::Affine3d& T) {
    for (const XMLElement* c = mesh.FirstChildElement(); c != nullptr;
         c = c->NextSiblingElement()) {
      const absl::string_view name = c->Name();
      if (name != "triangles" && name != "polylist" && name != "polygons") continue;
      RS_ASSIGN_OR_RETURN(const Layout layout, LayoutOf(*c));
      RS_ASSIGN_OR_RETURN(const std::vector<Vector3d> points, PointsOf(*layout.points, T));
      std::vector<size_t> counts;
      if (const XMLElement* list = c->FirstChildElement("vcount"); list != nullptr) {
        RS_ASSIGN_OR_RETURN(counts, List<size_t>(*list));
      }
      for (const XMLElement* p = c->FirstChildElement("p"); p != nullptr;
           p = p->NextSiblingElement("p")) {
        RS_ASSIGN_OR_RETURN(const std::vector<size_t> indices, List<size_t>(*p));
        const size_t all = indices.size() / layout.stride;
        std::vector<size_t> faces = counts;
        if (name == "triangles") faces.assign(all / 3, 3);
        if (name == "polygons") faces = {all};
        size_t first = 0;
        for (const size_t face : faces) {
          if (face > all - first) return file_.Error(*p, "has fewer indices than its faces need");
          for (size_t i = 2; i < face; ++i) {
            for (const size_t k : {first, first + i - 1, first + i}) {
              const size_t index = indices[k * layout.stride + layout.offset];
              if (index >= points.size())
                return file_.Error(*p, absl::StrCat("names corner ", index, " of ", points.size()));
              corners_.push_back(points[index]);
            }
          }
          if (corners_.size() > 3 * most_)
            return file_.Error(*p, absl::StrCat("more than ", most_, " triangles"));
          first += face;
        }
      }
    }
    return absl::OkStatus();
  }

  const XmlFile& file_;
  const size_t most_;
  std::map<std::string, const XMLElement*> by_id_;
  std::vector<Vector3d> corners_;
  int visited_ = 0;
};

}  // namespace

absl::StatusOr<std::vector<Vector3d>> ReadCollada(const std::string& name, const std::string& text,
                                                  size_t most) {
  RS_ASSIGN_OR_RETURN(const XmlFile file, XmlFile::Parse(name, text));
  return Reader(file, most).Read();
}

}  // namespace robostress
