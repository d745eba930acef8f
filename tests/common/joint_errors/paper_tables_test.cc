// The paper's tables, number for number as printed, against what the code computes.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <string>

#include "absl/strings/str_format.h"
#include "common/joint_errors/scenarios.h"

namespace robostress {
namespace {

// `computed` written with as many decimals as the paper prints.
void ExpectPrinted(double computed, const std::string& paper, const std::string& where) {
  const size_t point = paper.find('.');
  const int decimals = point == std::string::npos ? 0 : static_cast<int>(paper.size() - point - 1);
  EXPECT_EQ(absl::StrFormat("%.*f", decimals, computed), paper) << where;
}

// Parameters of joint 1..7 at the episode's first (progress 0) or last moment, object in hand.
JointErrorParameters At(const std::string& scenario, int joint, double progress, int level = 5) {
  return Scale(NominalPandaErrors()[joint - 1],
               FactorsAt(MakeScenario(scenario, level).value(), progress, 1)[joint - 1]);
}

// One row of printed parameters; an empty cell is a number that the paper's row does not give.
struct Printed {
  const char *Fc = "", *Fs = "", *vs = "", *sigma_v = "", *B = "", *M_eff = "", *D = "", *K = "";
};

void ExpectRow(const JointErrorParameters& p, const Printed& paper, const std::string& where) {
  const std::pair<double, const char*> cells[] = {
      {p.Fc, paper.Fc}, {p.Fs, paper.Fs},       {p.vs, paper.vs}, {p.sigma_v, paper.sigma_v},
      {p.B, paper.B},   {p.M_eff, paper.M_eff}, {p.D, paper.D},   {p.K, paper.K}};
  for (const auto& [computed, printed] : cells) {
    if (*printed != '\0') ExpectPrinted(computed, printed, where);
  }
}

// "J1-J4 / J5-J7" rows.
void ExpectRows(const std::string& scenario, double progress, const Printed& shoulder,
                const Printed& wrist) {
  for (int j = 1; j <= 7; ++j) {
    ExpectRow(At(scenario, j, progress), j <= 4 ? shoulder : wrist,
              scenario + " J" + std::to_string(j));
  }
}

constexpr Printed kNominalShoulder = {"2.175",   "3.480", "0.15",  "0.348",
                                      "0.00087", "0.70",  "90.73", "6000"};
constexpr Printed kNominalWrist = {"0.480",   "0.720", "0.10",  "0.048",
                                   "0.00130", "0.20",  "39.60", "4000"};
constexpr Printed kFullShoulder = {"4.350",   "6.960", "0.15",  "0.696",
                                   "0.01305", "0.70",  "40.58", "1200"};
constexpr Printed kFullWrist = {"0.960",   "1.440", "0.10",  "0.096",
                                "0.01950", "0.20",  "17.71", "800"};
constexpr std::array<const char*, 7> kNominalBeta = {"0.05", "0.10", "0.06", "0.10",
                                                     "0.08", "0.08", "0.05"};
constexpr std::array<const char*, 7> kFullBeta = {"0.20", "0.40", "0.24", "0.40",
                                                  "0.32", "0.32", "0.20"};

void ExpectBeta(const std::string& scenario, const std::array<const char*, 7>& paper) {
  for (int j = 1; j <= 7; ++j) ExpectPrinted(At(scenario, j, 1).beta, paper[j - 1], scenario);
}

TEST(PaperTables, BaseParams) {
  for (int j = 1; j <= 7; ++j) {
    const JointErrorParameters& p = NominalPandaErrors()[j - 1];
    // Nominal values are the printed decimals themselves; all others follow by factors.
    const Printed& row = j <= 4 ? kNominalShoulder : kNominalWrist;
    EXPECT_EQ(p.Fc, std::stod(row.Fc));
    EXPECT_EQ(p.Fs, std::stod(row.Fs));
    EXPECT_EQ(p.vs, std::stod(row.vs));
    EXPECT_EQ(p.sigma_v, std::stod(row.sigma_v));
    EXPECT_EQ(p.B, std::stod(row.B));
    EXPECT_EQ(p.M_eff, std::stod(row.M_eff));
    EXPECT_EQ(p.D, std::stod(row.D));
    EXPECT_EQ(p.K, std::stod(row.K));
    EXPECT_EQ(p.beta, std::stod(kNominalBeta[j - 1]));
    // sec:supp_base_params: zeta, f_n, half-width in degrees, D0 = 1.4 sqrt(K0 M).
    ExpectPrinted(p.D / (2 * std::sqrt(p.K * p.M_eff)), "0.70", "zeta");
    ExpectPrinted(std::sqrt(p.K / p.M_eff) / (2 * M_PI), j <= 4 ? "14.7" : "22.5", "f_n");
    ExpectPrinted(1.4 * std::sqrt(p.K * p.M_eff), j <= 4 ? "90.73" : "39.60", "D");
    EXPECT_NEAR(p.B * 180 / M_PI, j <= 4 ? 0.05 : 0.075, 0.0006);  // paper: approximately
  }
}

TEST(PaperTables, Severity) {
  const SeverityFactors worn = FactorsAt(MakeScenario("aged_joint_uniform", 5).value(), 1, 1)[0];
  const SeverityFactors loaded = FactorsAt(MakeScenario("heavy_payload", 5).value(), 1, 1)[0];
  EXPECT_EQ(worn.friction, 2);
  EXPECT_EQ(worn.backlash, 15);
  EXPECT_EQ(worn.compliance, 5);
  EXPECT_EQ(loaded.compliance, 5);
  EXPECT_EQ(loaded.gravity, 4);
  for (const JointErrorParameters& nominal : NominalPandaErrors()) {
    const JointErrorParameters p =
        Scale(nominal, {.friction = 2, .gravity = 4, .backlash = 15, .compliance = 5});
    EXPECT_DOUBLE_EQ(p.Fc / nominal.Fc, 2);
    EXPECT_DOUBLE_EQ(p.Fs / nominal.Fs, 2);
    EXPECT_DOUBLE_EQ(p.sigma_v / nominal.sigma_v, 2);
    EXPECT_DOUBLE_EQ(p.beta / nominal.beta, 4);
    EXPECT_DOUBLE_EQ(p.B / nominal.B, 15);
    EXPECT_DOUBLE_EQ(nominal.K / p.K, 5);
    EXPECT_DOUBLE_EQ(nominal.D / p.D, std::sqrt(5));
    EXPECT_EQ(p.vs, nominal.vs);
    EXPECT_EQ(p.M_eff, nominal.M_eff);
  }
}

TEST(PaperTables, Isolated) {
  ExpectRows("isolated_stribeck", 1,
             {.Fc = "4.350", .Fs = "6.960", .vs = "0.15", .sigma_v = "0.696"},
             {.Fc = "0.960", .Fs = "1.440", .vs = "0.10", .sigma_v = "0.096"});
  ExpectRows("isolated_backlash", 1, {.B = "0.01305"}, {.B = "0.01950"});
  ExpectPrinted(At("isolated_backlash", 1, 1).B * 180 / M_PI, "0.748", "degrees");
  ExpectPrinted(At("isolated_backlash", 7, 1).B * 180 / M_PI, "1.117", "degrees");
  ExpectRows("isolated_compliance", 1, {.M_eff = "0.70", .D = "40.58", .K = "1200"},
             {.M_eff = "0.20", .D = "17.71", .K = "800"});
  for (int j = 1; j <= 7; ++j) {
    const JointErrorParameters p = At("isolated_compliance", j, 1);
    ExpectPrinted(p.D / (2 * std::sqrt(p.K * p.M_eff)), "0.70", "zeta");
  }
  ExpectBeta("isolated_gravity", kFullBeta);
}

TEST(PaperTables, CompositeRampsRunFromTheirPrintedOnsetToTheirPrintedEnd) {
  ExpectRows("thermal_drift_stribeck", 0, {.Fc = "3.26", .Fs = "5.22", .sigma_v = "0.522"},
             {.Fc = "0.72", .Fs = "1.08", .sigma_v = "0.072"});
  ExpectRows("thermal_drift_stribeck", 1, {.Fc = "4.35", .Fs = "6.96", .sigma_v = "0.696"},
             {.Fc = "0.96", .Fs = "1.44", .sigma_v = "0.096"});
  ExpectRows("thermal_drift_backlash", 0, {.B = "0.00435"}, {.B = "0.0065"});
  ExpectRows("thermal_drift_backlash", 1, {.B = "0.01305"}, {.B = "0.0195"});
}

TEST(PaperTables, CompositeFixedScenariosAndTheirNominalRest) {
  ExpectRows("heavy_payload", 1,
             {kNominalShoulder.Fc, kNominalShoulder.Fs, "0.15", kNominalShoulder.sigma_v, "0.00087",
              "0.70", "40.58", "1200"},
             {kNominalWrist.Fc, kNominalWrist.Fs, "0.10", kNominalWrist.sigma_v, "0.00130", "0.20",
              "17.71", "800"});
  ExpectBeta("heavy_payload", kFullBeta);
  ExpectRows("aged_transmission", 1,
             {"4.35", "6.96", "0.15", "0.696", "0.01305", "0.70", "90.73", "6000"},
             {"0.96", "1.44", "0.10", "0.096", "0.01950", "0.20", "39.60", "4000"});
  ExpectRows("aged_joint_uniform", 1, kFullShoulder, kFullWrist);
  for (int j = 1; j <= 7; ++j) {
    ExpectRow(At("aged_joint_shoulder", j, 1),
              j <= 3   ? kFullShoulder
              : j == 4 ? kNominalShoulder
                       : kNominalWrist,
              "shoulder");
    ExpectRow(At("aged_joint_elbow", j, 1),
              j == 4  ? kFullShoulder
              : j < 4 ? kNominalShoulder
                      : kNominalWrist,
              "elbow");
  }
  for (const char* name :
       {"thermal_drift_stribeck", "thermal_drift_backlash", "aged_transmission",
        "aged_joint_uniform", "aged_joint_shoulder", "aged_joint_elbow", "nominal"}) {
    ExpectBeta(name, kNominalBeta);
  }
}

// One line of tab:supp_severity_levels.
struct Level {
  double friction, backlash, compliance, payload_compliance, payload_gravity, stribeck_end,
      backlash_end;
};
constexpr Level kLevels[] = {{1.5, 5, 2, 2, 2, 1.5, 5},
                             {1.625, 7.5, 2.75, 2.75, 2.5, 1.625, 7.5},
                             {1.75, 10, 3.5, 3.5, 3, 1.75, 10},
                             {1.875, 12.5, 4.25, 4.25, 3.5, 1.875, 12.5},
                             {2, 15, 5, 5, 4, 2, 15}};

void ExpectFactors(const std::string& scenario, int level, double progress, int first, int last,
                   const SeverityFactors& paper) {
  const auto factors = FactorsAt(MakeScenario(scenario, level).value(), progress, 1);
  for (int j = 1; j <= 7; ++j) {
    const SeverityFactors expected = j >= first && j <= last ? paper : SeverityFactors();
    const SeverityFactors& w = factors[j - 1];
    const std::string where = absl::StrFormat("%s L%d J%d", scenario, level, j);
    EXPECT_EQ(w.friction, expected.friction) << where;
    EXPECT_EQ(w.gravity, expected.gravity) << where;
    EXPECT_EQ(w.backlash, expected.backlash) << where;
    EXPECT_EQ(w.compliance, expected.compliance) << where;
  }
}

TEST(PaperTables, SeverityLevelsOfEveryScenario) {
  for (int level = 1; level <= 5; ++level) {
    const Level& row = kLevels[level - 1];
    const SeverityFactors gears = {.friction = row.friction, .backlash = row.backlash};
    SeverityFactors worn = gears;
    worn.compliance = row.compliance;
    ExpectFactors("aged_transmission", level, 1, 1, 7, gears);
    ExpectFactors("aged_joint_uniform", level, 1, 1, 7, worn);
    ExpectFactors("aged_joint_shoulder", level, 1, 1, 3, worn);
    ExpectFactors("aged_joint_elbow", level, 1, 4, 4, worn);
    ExpectFactors("heavy_payload", level, 1, 1, 7,
                  {.gravity = row.payload_gravity, .compliance = row.payload_compliance});
    ExpectFactors("thermal_drift_stribeck", level, 0, 1, 7, {.friction = 1.5});
    ExpectFactors("thermal_drift_stribeck", level, 1, 1, 7, {.friction = row.stribeck_end});
    ExpectFactors("thermal_drift_backlash", level, 0, 1, 7, {.backlash = 5});
    ExpectFactors("thermal_drift_backlash", level, 1, 1, 7, {.backlash = row.backlash_end});
    ExpectFactors("nominal", level, 1, 1, 7, {});
    ExpectFactors("isolated_stribeck", level, 1, 1, 7, {.friction = row.friction});
    ExpectFactors("isolated_backlash", level, 1, 1, 7, {.backlash = row.backlash});
    ExpectFactors("isolated_compliance", level, 1, 1, 7, {.compliance = row.compliance});
    ExpectFactors("isolated_gravity", level, 1, 1, 7, {.gravity = row.payload_gravity});
  }
}

}  // namespace
}  // namespace robostress
