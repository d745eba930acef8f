#include "sim_worker/libero/predicates.h"

#include <Eigen/Core>
#include <algorithm>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress::libero {
namespace {

Eigen::Vector3d BodyPosition(const mjData& data, int body) {
  return Eigen::Map<const Eigen::Vector3d>(data.xpos + 3 * body);
}

using RowMajor3d = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

bool IsOpen(const Articulation& a, double q) { return a.open_below ? q < a.open() : q > a.open(); }
bool IsClosed(const Articulation& a, double q) {
  return a.open_below ? q > a.close() : q < a.close();
}

}  // namespace

bool InContact(const mjData& data, const LiberoObject& a, const LiberoObject& b) {
  for (int i = 0; i < data.ncon; ++i) {
    const int g1 = data.contact[i].geom1, g2 = data.contact[i].geom2;
    if ((a.contact_geom[g1] && b.contact_geom[g2]) || (a.contact_geom[g2] && b.contact_geom[g1]))
      return true;
  }
  return false;
}

absl::StatusOr<LiberoGoal> LiberoGoal::Create(const LiberoScene& scene) {
  struct Known {
    const char* name;
    Kind kind;
    size_t arguments;
  };
  constexpr Known kKnown[] = {{"on", Kind::kOn, 2},         {"in", Kind::kIn, 2},
                              {"open", Kind::kOpen, 1},     {"close", Kind::kClose, 1},
                              {"turnon", Kind::kTurnOn, 1}, {"turnoff", Kind::kTurnOff, 1},
                              {"up", Kind::kUp, 1}};
  LiberoGoal goal;
  goal.scene_ = &scene;
  for (const BddlAtom& source : scene.problem.goal) {
    auto error = [&](const std::string& what) {
      return absl::InvalidArgumentError(
          absl::StrCat(scene.problem.file, ":", source.line, ": ", what));
    };
    const Known* known = nullptr;
    for (const Known& candidate : kKnown) {
      if (source.predicate == candidate.name) known = &candidate;
    }
    if (known == nullptr) {
      return error(absl::StrCat("predicate '", source.predicate,
                                "' is unknown; known: on in open close turnon turnoff up"));
    }
    if (source.arguments.size() != known->arguments) {
      return error(absl::StrCat("'", source.predicate, "' takes ", known->arguments, " names, got ",
                                source.arguments.size()));
    }
    auto object = [&](const std::string& name) -> const LiberoObject* {
      const auto found = scene.objects.find(name);
      return found == scene.objects.end() ? nullptr : &found->second;
    };
    auto site = [&](const std::string& name) -> const LiberoSite* {
      const auto found = scene.sites.find(name);
      return found == scene.sites.end() ? nullptr : &found->second;
    };
    if (known->arguments == 2 && source.arguments[0] == source.arguments[1])
      return error(absl::StrCat("'", source.arguments[0], "' cannot be ", source.predicate,
                                " itself; correct one of the two names"));
    Atom atom{known->kind};
    const std::string& last = source.arguments.back();
    if (known->arguments == 2 || known->kind == Kind::kUp) {
      atom.object = object(source.arguments[0]);
      if (atom.object == nullptr)
        return error(
            absl::StrCat("'", source.arguments[0], "' is not an object or fixture of this file"));
    }
    if (known->kind != Kind::kUp) {
      atom.site = site(last);
      atom.target = object(atom.site != nullptr ? atom.site->parent : last);
      if (atom.site == nullptr && atom.target == nullptr) {
        return error(absl::StrCat("'", last, "' is neither an object nor a region with a site"));
      }
    }
    if (known->kind == Kind::kIn && atom.site == nullptr) {
      return error(absl::StrCat("'in' needs a region with a site, '", last, "' is an object"));
    }
    if (known->arguments == 1 && known->kind != Kind::kUp) {
      const bool is_switch = known->kind == Kind::kTurnOn || known->kind == Kind::kTurnOff;
      const Articulation* articulation =
          atom.target == nullptr ? nullptr : atom.target->articulation;
      if (articulation == nullptr || articulation->has_switch != is_switch) {
        return error(absl::StrCat("'", last, "' cannot ", source.predicate));
      }
      if (is_switch && atom.site != nullptr)
        return error(absl::StrCat("'", source.predicate, "' takes an object, not a region"));
      atom.joints = atom.site != nullptr ? atom.site->joints : atom.target->joints;
    }
    goal.atoms_.push_back(std::move(atom));
  }
  return goal;
}

bool LiberoGoal::Evaluate(const Atom& atom, const mjData& data) const {
  const mjModel& model = *scene_->model;
  auto coordinate = [&](int joint) { return data.qpos[model.jnt_qposadr[joint]]; };
  auto any = [&](auto test) {
    return std::any_of(atom.joints.begin(), atom.joints.end(),
                       [&](int j) { return test(coordinate(j)); });
  };
  auto all = [&](auto test) {
    return std::all_of(atom.joints.begin(), atom.joints.end(),
                       [&](int j) { return test(coordinate(j)); });
  };
  switch (atom.kind) {
    case Kind::kOpen:
      return any([&](double q) { return IsOpen(*atom.target->articulation, q); });
    case Kind::kClose:
      return all([&](double q) { return IsClosed(*atom.target->articulation, q); });
    case Kind::kTurnOn:
      return any([&](double q) { return q >= atom.target->articulation->on(); });
    case Kind::kTurnOff:
      return all([&](double q) { return q < atom.target->articulation->off(); });
    case Kind::kUp:
      return BodyPosition(data, atom.object->body).z() >= 1.0;
    case Kind::kOn:
    case Kind::kIn:
      break;
  }
  const Eigen::Vector3d p = BodyPosition(data, atom.object->body);
  if (atom.site == nullptr) {
    const Eigen::Vector3d support = BodyPosition(data, atom.target->body);
    return support.z() <= p.z() && (support - p).head<2>().norm() < 0.03 &&
           InContact(data, *atom.target, *atom.object);
  }
  const Eigen::Vector3d p_site =
      Eigen::Map<const Eigen::Vector3d>(data.site_xpos + 3 * atom.site->site);
  const Eigen::Matrix3d R_site = Eigen::Map<const RowMajor3d>(data.site_xmat + 9 * atom.site->site);
  const Eigen::Vector3d size =
      Eigen::Map<const Eigen::Vector3d>(model.site_size + 3 * atom.site->site);
  if (atom.kind == Kind::kIn) {
    const Eigen::Vector3d half = (R_site * size).cwiseAbs();
    Eigen::Vector3d lower = p_site - half;
    lower.z() -= 0.01;
    return (p.array() > lower.array()).all() && (p.array() < (p_site + half).array()).all();
  }
  const Eigen::Vector3d d = R_site * (p - p_site);
  return size.z() - 0.005 < d.z() && d.z() < size.z() + 0.10 && std::abs(d.x()) < size.x() &&
         std::abs(d.y()) < size.y() &&
         (atom.target == nullptr || InContact(data, *atom.target, *atom.object));
}

std::vector<bool> LiberoGoal::Evaluate(const mjData& data) const {
  std::vector<bool> values;
  for (const Atom& atom : atoms_) values.push_back(Evaluate(atom, data));
  return values;
}

bool LiberoGoal::Holds(const mjData& data) const {
  return std::all_of(atoms_.begin(), atoms_.end(),
                     [&](const Atom& atom) { return Evaluate(atom, data); });
}

}  // namespace robostress::libero
