#include "sim_worker/libero/fixture_poses.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/random.h"
#include "common/status_macros.h"

namespace robostress::libero {

using Source = LiberoFixtures::Source;

absl::StatusOr<FixturePoses> FixturePoses::Create(const LiberoFixtures& choice,
                                                  const std::string& task,
                                                  const LiberoScene& scene) {
  FixturePoses result(choice, task, scene);
  if (choice.source == Source::kTable) {
    RS_ASSIGN_OR_RETURN(result.table_, ReadFixtureTable(choice.table, task, scene));
  }
  if (choice.source == Source::kNumpy) {
    RS_ASSIGN_OR_RETURN(result.numpy_, NumpyPlacement::Create(scene, choice.seed));
  }
  return result;
}

absl::Status FixturePoses::CheckListed(int first, int count) const {
  if (choice_.source != Source::kTable || scene_->centred_fixtures.empty()) return absl::OkStatus();
  std::vector<int> absent;
  for (int state = first; state < first + count; ++state) {
    if (!table_.contains(state)) absent.push_back(state);
  }
  if (absent.empty()) return absl::OkStatus();
  return absl::NotFoundError(
      absl::StrCat(choice_.table, ": task '", task_, "': no poses for initial state ",
                   absl::StrJoin(absent, ", "), "; it has ", table_.size(),
                   " initial states; add what is absent, or choose others with --episodes and "
                   "--first-initial-state"));
}

absl::StatusOr<std::vector<FixturePose>> FixturePoses::At(int initial_state) {
  if (scene_->centred_fixtures.empty()) return std::vector<FixturePose>();
  switch (choice_.source) {
    case Source::kCentred:
      break;
    case Source::kSampled:
      return SampleFixtures(
          *scene_, StreamKey("libero fixtures").With(task_).With(int64_t{initial_state}).lo());
    case Source::kNumpy:
      if (choice_.each_seeded) {
        // One reset is the environment's first, before any seed. A sum beyond 2^32, which NumPy
        // refuses as a seed, begins anew.
        RS_ASSIGN_OR_RETURN(NumpyPlacement numpy,
                            NumpyPlacement::Create(*scene_, choice_.seed + initial_state,
                                                   /*resets_before=*/initial_state + 1));
        RS_ASSIGN_OR_RETURN(ResetDraw draw, numpy.Reset());
        return std::move(draw.fixtures);
      }
      while (static_cast<int>(resets_.size()) <= initial_state) {
        RS_ASSIGN_OR_RETURN(ResetDraw draw, numpy_->Reset());
        resets_.push_back(std::move(draw.fixtures));
      }
      return resets_[initial_state];
    case Source::kTable:
      RS_RETURN_IF_ERROR(CheckListed(initial_state, 1));
      return table_.at(initial_state);
  }
  return scene_->centred_fixtures;
}

}  // namespace robostress::libero
