// PandaSim in a model that robosuite compiled: wrapped_reference MODEL.mjb INPUT SCENARIO. INPUT
// has raw doubles: qpos [nq], joints where the arm was reset [7], actions [n][7]. Writes the arm's
// joints after each action.
#include <cstdio>
#include <fstream>
#include <iterator>
#include <vector>

#include "common/joint_errors/scenarios.h"
#include "sim_worker/panda_sim.h"

namespace robostress {
namespace {

constexpr int kHorizon = 100;

std::vector<double> ReadDoubles(const char* file) {
  std::ifstream in(file, std::ios::binary);
  const std::vector<char> bytes{std::istreambuf_iterator<char>(in), {}};
  std::vector<double> values(bytes.size() / sizeof(double));
  std::copy_n(bytes.data(), values.size() * sizeof(double), reinterpret_cast<char*>(values.data()));
  return values;
}

int Play(const char* file, const std::vector<double>& input, const char* scenario) {
  SharedModel model(mj_loadModel(file, nullptr),
                    [](const mjModel* m) { mj_deleteModel(const_cast<mjModel*>(m)); });
  if (model == nullptr) return 1;
  SimOptions options;
  options.stepping = Stepping::kParity;
  const auto sim = PandaSim::Create(model, options);
  if (!sim.ok()) {
    std::fprintf(stderr, "%s\n", std::string(sim.status().message()).c_str());
    return 1;
  }
  const size_t nq = static_cast<size_t>(model->nq);
  const Eigen::Matrix<double, 7, 1> home(&input[nq]);
  (*sim)->SetScenario(*MakeScenario(scenario, 5), kHorizon);
  if (!(*sim)->Reset({input.data(), nq}, home).ok()) return 1;
  for (size_t at = nq + 7; at + 7 <= input.size(); at += 7) {
    const Eigen::Matrix<double, 7, 1> action(&input[at]);
    if (!(*sim)->StepExact(action).ok()) return 1;
    std::fwrite((*sim)->data().qpos, sizeof(double), 7, stdout);
  }
  return 0;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  return argc == 4 ? robostress::Play(argv[1], robostress::ReadDoubles(argv[2]), argv[3]) : 2;
}
