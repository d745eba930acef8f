#include "common/models/urdf_parts.h"

#include <utility>

#include "absl/strings/str_format.h"

namespace robostress::urdf {
namespace {

class Printer {
 public:
  void Open(const char* element) { printer_.OpenElement(element, true); }
  void Close() { printer_.CloseElement(true); }
  void Text(const char* name, const std::string& value) {
    printer_.PushAttribute(name, value.c_str());
  }
  void Number(const char* name, double value) { printer_.PushAttribute(name, value); }
  void Triple(const char* name, const std::vector<double>& v) {
    Text(name, absl::StrFormat("%.17g %.17g %.17g", v[0], v[1], v[2]));
  }
  void Origin(const Pose& pose) {
    Open("origin");
    Triple("xyz", pose.xyz);
    Triple("rpy", pose.rpy);
    Close();
  }
  std::string text() const { return printer_.CStr(); }

 private:
  tinyxml2::XMLPrinter printer_{nullptr, true};
};

void PrintShape(const Shape& shape, Printer& out) {
  out.Open(shape.touched ? "collision" : "visual");
  out.Origin(shape.origin);
  out.Open("geometry");
  out.Open(shape.kind.c_str());
  for (const auto& [name, value] : shape.attributes) out.Text(name.c_str(), value);
  out.Close();
  out.Close();
  out.Close();
}

void PrintLink(const Link& link, Printer& out) {
  out.Open("link");
  out.Text("name", link.name);
  if (link.mass > 0) {
    out.Open("inertial");
    out.Origin(link.com);
    out.Open("mass");
    out.Number("value", link.mass);
    out.Close();
    out.Open("inertia");
    const auto& I = link.inertia;
    for (const auto& [name, value] :
         {std::pair("ixx", I(0, 0)), std::pair("iyy", I(1, 1)), std::pair("izz", I(2, 2)),
          std::pair("ixy", I(0, 1)), std::pair("ixz", I(0, 2)), std::pair("iyz", I(1, 2))})
      out.Number(name, value);
    out.Close();
    out.Close();
  }
  for (const Shape& shape : link.shapes) PrintShape(shape, out);
  out.Close();
}

void PrintJoint(const Joint& joint, const std::string& parent, const std::string& child,
                Printer& out) {
  out.Open("joint");
  out.Text("name", joint.name);
  out.Text("type", joint.moves ? joint.type : "fixed");
  for (const auto& [side, link] : {std::pair("parent", parent), std::pair("child", child)}) {
    out.Open(side);
    out.Text("link", link);
    out.Close();
  }
  out.Origin(joint.origin);
  if (joint.moves) {
    out.Open("axis");
    out.Triple("xyz", joint.axis);
    out.Close();
    out.Open("dynamics");
    out.Number("damping", joint.damping);
    out.Number("friction", joint.friction);
    out.Close();
    if (joint.limited) {
      out.Open("limit");
      out.Number("lower", joint.lower);
      out.Number("upper", joint.upper);
      out.Number("effort", joint.effort > 0 ? joint.effort : kUnknownLimit);
      out.Number("velocity", kUnknownLimit);
      out.Close();
    }
    if (!joint.mimic.empty()) {
      out.Open("mimic");
      out.Text("joint", joint.mimic);
      out.Number("multiplier", joint.multiplier);
      out.Number("offset", joint.offset);
      out.Close();
    }
  }
  out.Close();
}

}  // namespace

std::string Print(const std::vector<Link>& links, const std::vector<Joint>& joints) {
  Printer out;
  out.Open("robot");
  out.Text("name", "arm");
  out.Open("mujoco");
  out.Open("compiler");
  out.Text("fusestatic", "false");
  out.Text("strippath", "false");
  out.Close();
  out.Close();
  for (const Link& link : links) PrintLink(link, out);
  for (const Joint& joint : joints)
    PrintJoint(joint, links[static_cast<size_t>(joint.parent)].name,
               links[static_cast<size_t>(joint.child)].name, out);
  out.Close();
  return out.text();
}

}  // namespace robostress::urdf
