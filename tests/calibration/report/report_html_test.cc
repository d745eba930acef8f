#include <string>
#include <utility>

#include "absl/strings/str_replace.h"
#include "calibration/search/calibration_report.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "tests/calibration/report/report_fixture.h"

namespace robostress::calibration {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

CalibrationReport With(Verdict verdict) {
  CalibrationReport report = AttributedReport();
  report.verdict = report.joints[0].verdict = verdict;
  return report;
}

// Position of `text`, which must occur.
size_t Find(const std::string& html, const std::string& text) {
  const size_t at = html.find(text);
  EXPECT_NE(at, std::string::npos) << text;
  return at;
}

TEST(ReportHtml, SaysEachVerdictByNameAndInWords) {
  const std::pair<Verdict, const char*> texts[] = {
      {Verdict::kAttributed, "The effect that the declared model lacked is named"},
      {Verdict::kAmbiguous, "this data leaves a choice"},
      {Verdict::kReducedNotAttributed, "the mechanism is not established"},
      {Verdict::kUnattributed, "no known effect explains"},
      {Verdict::kDeclaredSufficient, "nothing but noise is left"},
      {Verdict::kNotTestable, "cannot tell"}};
  for (const auto& [verdict, text] : texts) {
    const std::string html = ReportHtml(With(verdict));
    EXPECT_THAT(html, HasSubstr(text));
    EXPECT_THAT(html, HasSubstr(std::string(">") + VerdictName(verdict) + "</span>"));
    EXPECT_THAT(html, HasSubstr("beats the best of 999 surrogates"));
  }
}

TEST(ReportHtml, TellsTheStoryInOrder) {
  const std::string html = ReportHtml(AttributedReport());
  size_t last = 0;
  for (const char* heading :
       {"What was declared", "How far it is off", "What the residual looks like", "What was tried",
        "What was accepted, and why", "Before and after", "What remains", "What to do with it",
        "The logs"}) {
    const size_t at = Find(html, std::string(">") + heading + "<");
    EXPECT_GT(at, last) << heading;
    last = at;
  }
}

TEST(ReportHtml, HoldsTheFigures) {
  const std::string html = ReportHtml(AttributedReport());
  for (const char* text :
       {"0.724 mm", "0.493 mm", "\u221232 %", "0.724 \u2192 0.493 mm",
        "\u221237.02 \u00b1 0.84 N s/m", "p \u2264 0.001", "95.31 \u00b1 0.12",
        "torque_offset falls from -3.17", "gain in 2 of 4 folds", "transport_delay, servo_lag",
        "quadratic_viscous_friction (7.0 %)", "clock: 3 gaps of one row", "rig_after.yaml",
        "torque -d_sigma |dq|", "velocity: 0.41 of the variance",
        "the model is off by 56 times that", "9.60 \u2192 9.18 mm"}) {
    EXPECT_THAT(html, HasSubstr(text));
  }
}

TEST(ReportHtml, ShowsTheGroupWithTheExperimentThatSeparatesIt) {
  CalibrationReport report = With(Verdict::kAmbiguous);
  report.joints[0].effects[0].ambiguous_with = {"cable_spring"};
  report.joints[0].effects[0].separating_experiment = "several speeds each way";
  const std::string html = ReportHtml(report);
  EXPECT_THAT(html,
              HasSubstr("</b> or cable_spring? To tell them apart: several speeds each way."));
}

TEST(ReportHtml, SaysWhatToDoNext) {
  CalibrationReport report = With(Verdict::kUnattributed);
  report.joints[0].next_experiment.text = "to tell a from b, record c";
  EXPECT_THAT(ReportHtml(report), HasSubstr("What to do next: to tell a from b, record c."));
  const auto json = nlohmann::json::parse(ReportJson(report));
  EXPECT_EQ(json["separating_experiment"], "slider: to tell a from b, record c");
}

TEST(ReportHtml, DrawsNothingOfAModelAfterWhereNothingWasAdded) {
  CalibrationReport report = With(Verdict::kUnattributed);
  report.joints[0].effects.clear();
  report.model_out.clear();
  const std::string html = ReportHtml(report);
  for (const char* text : {"after calibration", "Before and after", "What was accepted",
                           "rig_after", "With what was added", "0.493"}) {
    EXPECT_THAT(html, Not(HasSubstr(text)));
  }
  EXPECT_THAT(html, HasSubstr("How far it is off"));
}

TEST(ReportHtml, LeavesOutWhatTheReportDoesNotSay) {
  CalibrationReport report;
  report.rig = "bare";
  report.verdict = Verdict::kNotTestable;
  report.joints.resize(1);
  report.joints[0].joint = "hinge";
  const std::string html = ReportHtml(report);
  EXPECT_THAT(html, Not(HasSubstr("<h3>")));
  EXPECT_THAT(html, Not(HasSubstr("<h2")));
  EXPECT_THAT(html, Not(HasSubstr("<svg")));
  EXPECT_THAT(html, Not(HasSubstr("<table>")));
}

TEST(ReportHtml, HasAnOverviewAndASectionForEachJointOfAnArm) {
  CalibrationReport report = AttributedReport();
  report.joints.push_back(report.joints[0]);
  report.joints[1].joint = "joint_2";
  report.joints[1].verdict = Verdict::kDeclaredSufficient;
  report.joints[1].effects.clear();
  report.evidence = {"asymmetric_viscous at one joint only: mechanical"};
  const std::string html = ReportHtml(report);
  EXPECT_LT(Find(html, "href=\"#joint1\">joint_2</a></td>"), Find(html, "<h2>Joint slider"));
  EXPECT_LT(Find(html, "<h2>Joint slider"), Find(html, "<h2>Joint joint_2"));
  EXPECT_THAT(html, HasSubstr("at one joint only: mechanical"));
}

TEST(ReportHtml, FoldsAwayWhatDidNotComeNear) {
  const std::string html = ReportHtml(AttributedReport());
  EXPECT_LT(Find(html, "time_drift_friction</td>"), Find(html, "<details>"));
  EXPECT_GT(Find(html, "servo_lag</td>"), Find(html, "<details>"));
}

TEST(ReportHtml, DoesNotCallAcceptedWhatAnotherModelBeat) {
  CalibrationReport report = AttributedReport();
  report.joints[0].rounds[0].candidates[1].accepted = true;  // passed, and is not in the result
  EXPECT_THAT(ReportHtml(report), HasSubstr("passes every test alone; another model is better"));
  EXPECT_THAT(ReportHtml(AttributedReport()), Not(HasSubstr("passes every test alone")));
}

TEST(ReportHtml, NamesFilesWithoutTheirFolders) {
  CalibrationReport report = AttributedReport();
  report.rig_file = "/home/someone/rigs/rig_7.yaml";
  report.logs[0].file = "/home/someone/logs/log_7.csv";
  const std::string html = ReportHtml(report);
  EXPECT_THAT(html, Not(HasSubstr("/home/someone")));
  EXPECT_THAT(html, HasSubstr("rig_7.yaml"));
  EXPECT_THAT(html, HasSubstr("<td>log_7.csv</td>"));
}

TEST(ReportHtml, EscapesNamesFromFiles) {
  CalibrationReport report = AttributedReport();
  const std::string name = "<script>\"&", escaped = "&lt;script&gt;&quot;&amp;";
  report.rig = report.rig_file = report.model = report.because = name;
  report.logs[0].file = report.logs[0].condition = report.logs[1].notes[0] = name;
  JointReport& joint = report.joints[0];
  joint.joint = joint.because = joint.unit = name;
  joint.declared_parameters[0].name = joint.declared_parameters[0].unit = name;
  joint.rounds[0].candidates[1].type = joint.rounds[0].candidates[1].reason = name;
  joint.examples[0].log = joint.structure[0].against = joint.structure[0].unit = name;
  joint.mimics_exposed = {name};
  joint.effects[0].type = joint.effects[0].parameters[0].name = name;
  joint.groups = {{name, name}};
  const std::string html = ReportHtml(report);
  EXPECT_THAT(html, Not(HasSubstr("<script")));
  EXPECT_THAT(html, HasSubstr(escaped));
}

TEST(ReportHtml, NeedsNothingElse) {
  std::string html = ReportHtml(AttributedReport());
  html = absl::StrReplaceAll(html, {{"http://www.w3.org/2000/svg", ""}});
  for (const char* text : {"http", "src=", "<script", "url(", "nan", "inf "})
    EXPECT_THAT(html, Not(HasSubstr(text)));
}

}  // namespace
}  // namespace robostress::calibration
