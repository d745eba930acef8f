#include "sim_worker/libero/task_doubts.h"

#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "sim_worker/libero/catalog.h"

namespace robostress::libero {

std::vector<std::string> DoubtsOf(const BddlProblem& problem) {
  static const auto& predicates =
      *new std::set<std::string>{"on", "in", "open", "close", "turnon", "turnoff"};
  std::vector<std::string> doubts;
  std::set<std::string> names;
  std::map<std::string, int> unplaced;  // fixtures, and their lines
  const absl::StatusOr<ProblemClass> known = FindProblemClass(problem.name);
  for (const auto* groups : {&problem.fixtures, &problem.objects}) {
    for (const BddlGroup& group : *groups) {
      names.insert(group.instances.begin(), group.instances.end());
      if (groups == &problem.objects || (known.ok() && group.category == known->workspace))
        continue;
      for (const std::string& instance : group.instances) unplaced[instance] = group.line;
    }
  }
  for (const BddlRegion& region : problem.regions) names.insert(region.name);
  for (const BddlAtom& atom : problem.init) {
    const std::string place = absl::StrCat(problem.file, ":", atom.line, ": ");
    if (!predicates.contains(atom.predicate)) {
      doubts.push_back(absl::StrCat(place, "'", atom.predicate, "' is skipped, it is none of ",
                                    absl::StrJoin(predicates, ", ")));
    }
    for (const std::string& name : atom.arguments) {
      if (!names.contains(name)) {
        doubts.push_back(
            absl::StrCat(place, "'", name, "' is neither an object nor a region of the file"));
      }
    }
    if (atom.predicate != "on" || atom.arguments.size() != 2) continue;
    const BddlRegion* region = problem.FindRegion(atom.arguments[1]);
    if (region != nullptr && !region->ranges.empty()) unplaced.erase(atom.arguments[0]);
  }
  for (const auto& [fixture, line] : unplaced) {
    doubts.push_back(
        absl::StrCat(problem.file, ":", line, ": fixture '", fixture, "' is placed by no (On ",
                     fixture, " REGION WITH RANGES) of :init and stands at the world's origin"));
  }
  return doubts;
}

}  // namespace robostress::libero
