// The reader of LIBERO's task files.
#include "common/libero/bddl.h"
#include "tests/fuzz/fuzz_check.h"
#include "tests/fuzz/splice_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  const std::string file = "task.bddl";
  const absl::StatusOr<libero::BddlProblem> problem =
      libero::ParseBddl(file, {reinterpret_cast<const char*>(data), size});
  if (!problem.ok()) {
    CheckRefusal(problem.status(), file);
    return 0;
  }
  FuzzCheck(!problem->name.empty() && !problem->goal.empty(), "a task without name or goal");
  for (const libero::BddlRegion& region : problem->regions)
    FuzzCheck(problem->FindRegion(region.name) == &region, "two regions have one name");
  for (const libero::BddlAtom& atom : problem->goal)
    FuzzCheck(!atom.predicate.empty() && atom.line > 0, "a goal without predicate or line");
  return 0;
}

extern "C" size_t LLVMFuzzerCustomMutator(uint8_t* data, size_t size, size_t max_size,
                                          unsigned int seed) {
  std::vector<size_t> words;
  for (size_t i = 0; i < size; ++i) {
    if (data[i] == '(' || data[i] == ')' || data[i] == ' ' || data[i] == '\n') words.push_back(i);
  }
  return robostress::MutateBetween(words, data, size, max_size, seed);
}
