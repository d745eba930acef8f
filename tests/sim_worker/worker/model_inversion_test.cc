#include "sim_worker/worker/model_inversion.h"

#include <gtest/gtest.h>

#include <functional>
#include <memory>

#include "common/status_macros.h"
#include "tests/sim_worker/test_scene.h"

namespace robostress {
namespace {

// Where the tool is after each of 25 steps of a policy whose command turns round.
std::vector<Eigen::Vector3d> Path(const std::string& scenario, CommandInversion* inversion,
                                  PandaSim& sim) {
  UseScenario(sim, scenario);
  EXPECT_TRUE(sim.Reset(HomeState(sim), PandaHome()).ok());
  if (inversion != nullptr) inversion->StartEpisode();
  std::vector<Eigen::Vector3d> path;
  for (int step = 0; step < 25; ++step) {
    Eigen::MatrixXf rows(8, 7);
    for (int i = 0; i < 8; ++i) rows.row(i) = Command(step + i < 12 ? 0.5 : -0.4, 0.3, 0.3);
    Eigen::VectorXf command = rows.row(0).transpose();
    if (inversion != nullptr) {
      const auto chosen = inversion->Command(rows, sim.Measure());
      EXPECT_TRUE(chosen.ok()) << chosen.status();
      command = *chosen;
    }
    EXPECT_TRUE(sim.Step(command).ok());
    path.push_back(sim.Measure().tool.p_base_tool);
  }
  return path;
}

double Apart(const std::vector<Eigen::Vector3d>& a, const std::vector<Eigen::Vector3d>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += (a[i] - b[i]).norm() / static_cast<double>(a.size());
  return sum;
}

std::unique_ptr<ModelInversion> Inversion(const PandaSim& sim, const std::string& of, bool truth) {
  const auto scenario = MakeScenario(of, 5);
  EXPECT_TRUE(scenario.ok()) << scenario.status();
  auto made = truth ? ModelInversion::OfTruth(sim, {}, *scenario, 220)
                    : ModelInversion::OfModel(sim, {}, *scenario, 220);
  EXPECT_TRUE(made.ok()) << made.status();
  return *std::move(made);
}

class ModelInversionTest : public testing::Test {
 protected:
  // Mean distance to the arm without errors [m].
  double Distance(const std::string& scenario, CommandInversion* inversion) {
    return Apart(Path(scenario, inversion, *sim_), Path("clean", nullptr, *other_));
  }
  const std::unique_ptr<PandaSim> sim_ = MakeTestSim(), other_ = MakeTestSim();
};

TEST_F(ModelInversionTest, TheArmsOwnErrorsAreTakenOffByPrediction) {
  for (const char* scenario : {"isolated_gravity", "isolated_stribeck", "aged_joint_uniform"}) {
    const double without = Distance(scenario, nullptr);
    EXPECT_LT(Distance(scenario, Inversion(*sim_, scenario, true).get()), 0.4 * without)
        << scenario;
    const auto identified = Inversion(*sim_, scenario, false);
    EXPECT_LT(Distance(scenario, identified.get()), 0.6 * without) << scenario;
    EXPECT_GT(identified->confidence(), 0.5) << scenario;
  }
}

TEST_F(ModelInversionTest, AModelWithoutErrorsChangesNothing) {
  const auto nothing = Inversion(*sim_, "clean", false);
  EXPECT_EQ(Path("aged_joint_uniform", nothing.get(), *sim_),
            Path("aged_joint_uniform", nullptr, *other_));
  EXPECT_EQ(nothing->confidence(), 0);
}

TEST_F(ModelInversionTest, AModelThatIsWrongIsNotBelieved) {
  const auto wrong = Inversion(*sim_, "isolated_gravity", false);
  EXPECT_LT(Distance("clean", wrong.get()), 0.0005);
  EXPECT_LT(wrong->confidence(), 0.1);
}

TEST_F(ModelInversionTest, EpisodesDoNotDependOnThoseBefore) {
  const auto inversion = Inversion(*sim_, "aged_joint_uniform", false);
  const auto first = Path("aged_joint_uniform", inversion.get(), *sim_);
  EXPECT_EQ(Path("aged_joint_uniform", inversion.get(), *sim_), first);
}

}  // namespace
}  // namespace robostress
