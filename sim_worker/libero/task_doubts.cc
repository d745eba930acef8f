#include "sim_worker/libero/task_doubts.h"

#include <filesystem>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress::libero {

std::vector<std::string> DoubtsOf(const BddlProblem& problem) {
  static const auto& predicates =
      *new std::set<std::string>{"on", "in", "open", "close", "turnon", "turnoff"};
  std::vector<std::string> doubts;
  std::set<std::string> names;
  for (const auto* groups : {&problem.fixtures, &problem.objects}) {
    for (const BddlGroup& group : *groups)
      names.insert(group.instances.begin(), group.instances.end());
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
  }
  if (problem.language.empty()) {
    doubts.push_back(absl::StrCat(
        problem.file, ": no words in (:language ...): the policy is told the file's name, '",
        LiberoInstruction(std::filesystem::path(problem.file).stem().string()), "'"));
  }
  return doubts;
}

absl::Status CheckFixturesPlaced(const BddlProblem& problem, const ProblemClass& problem_class) {
  for (const BddlGroup& group : problem.fixtures) {
    if (group.category == problem_class.workspace) continue;
    for (const std::string& fixture : group.instances) {
      const BddlAtom* placed = nullptr;
      for (const BddlAtom& atom : problem.init) {
        if (atom.predicate != "on" || atom.arguments.size() != 2 || atom.arguments[0] != fixture)
          continue;
        const BddlRegion* region = problem.FindRegion(atom.arguments[1]);
        if (region == nullptr || region->ranges.empty()) continue;
        if (placed != nullptr) {
          return absl::InvalidArgumentError(absl::StrCat(
              problem.file, ":", atom.line, ": fixture '", fixture,
              "' is placed a second time, line ", placed->line, " places it; leave one of them"));
        }
        placed = &atom;
      }
      if (placed == nullptr) {
        return absl::InvalidArgumentError(absl::StrCat(
            problem.file, ":", group.line, ": fixture '", fixture, "' is placed by no (On ",
            fixture,
            " REGION) of :init whose region has :ranges, it would stand at the world's "
            "origin; add the line, or correct the region's name"));
      }
    }
  }
  return absl::OkStatus();
}

}  // namespace robostress::libero
