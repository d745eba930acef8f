// Damaged model files: a model is read whole or refused by the file's name, and nothing crashes.
#include <gmock/gmock.h>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/random.h"
#include "tests/calibration/model/model_text.h"

namespace robostress::calibration {
namespace {

using testing::HasSubstr;

class UrdfDamageTest : public ModelText {
 protected:
  // Through MuJoCo as well: what is read has finite terms.
  void Check(const std::string& text) {
    const auto loaded = Load(text, {"shoulder", "elbow"});
    if (!loaded.ok()) {
      EXPECT_THAT(std::string(loaded.status().message()), HasSubstr("arm.model")) << text;
      ++refused_;
      return;
    }
    ++read_;
    EXPECT_EQ(loaded->model->nv, 2) << text;
    for (int body = 1; body < loaded->model->nbody; ++body)
      EXPECT_TRUE(loaded->model->body_mass[body] >= 0 && loaded->model->body_mass[body] <= 1e6);
  }
  int refused_ = 0, read_ = 0;
};

// Every value of the file becomes every wrong one.
TEST_F(UrdfDamageTest, WrongValuesAreReadWholeOrRefusedByTheFilesName) {
  const std::string text = kTwoLinks;
  for (size_t begin = text.find("=\""); begin != std::string::npos;
       begin = text.find("=\"", begin + 2)) {
    const size_t end = text.find('"', begin + 2);
    for (const char* wrong :
         {"", "nan", "inf", "-1", "0", "1e308", "-1e-320", "1 2 3 4", "0 0 0", "upper", "base",
          "shoulder", "&lt;", "&#0;", "x\xff\xfe", "1,5", "fixed", "floating", "planar"})
      Check(text.substr(0, begin + 2) + wrong + text.substr(end));
  }
  EXPECT_GT(refused_, 500);
  EXPECT_GT(read_, 100);
}

TEST_F(UrdfDamageTest, MissingAndRepeatedElementsAreReadWholeOrRefused) {
  const std::vector<std::string> lines = absl::StrSplit(kTwoLinks, '\n');
  for (size_t i = 0; i < lines.size(); ++i)
    for (const int times : {0, 2, 3}) {
      std::string text;
      for (size_t k = 0; k < lines.size(); ++k)
        for (int n = 0; n < (k == i ? times : 1); ++n) absl::StrAppend(&text, lines[k], "\n");
      Check(text);
    }
  EXPECT_GT(refused_, 50);
}

TEST_F(UrdfDamageTest, FlippedAndCutBytesAreReadWholeOrRefused) {
  RandomStream random(StreamKey("urdf damage"));
  const std::string text = kTwoLinks;
  for (int i = 0; i < 1000; ++i) {
    std::string damaged = text;
    for (int n = random.UniformInt(4); n >= 0; --n)
      damaged[static_cast<size_t>(random.UniformInt(static_cast<int>(damaged.size())))] =
          static_cast<char>(random.UniformInt(256));
    if (random.UniformInt(4) == 0)
      damaged.resize(static_cast<size_t>(random.UniformInt(static_cast<int>(damaged.size()))));
    Check(damaged);
  }
  EXPECT_GT(refused_, 250);
}

TEST_F(UrdfDamageTest, SizeIsBounded) {
  std::string deep = "<robot>", chain = "<robot><link name=\"0\"/>";
  for (int i = 0; i < 5000; ++i) deep += "<link>";
  EXPECT_THAT(Refusal(deep, {"elbow"}), HasSubstr("arm.model"));
  for (int i = 1; i < 2000; ++i)
    absl::StrAppend(&chain, "<link name=\"", i, "\"/><joint name=\"j", i,
                    "\" type=\"fixed\"><parent link=\"", i - 1, "\"/><child link=\"", i,
                    "\"/></joint>");
  EXPECT_THAT(Refusal(chain + "</robot>", {"elbow"}), HasSubstr("more than 1000 links"));
  EXPECT_THAT(Refusal(std::string(17 << 20, ' '), {"elbow"}), HasSubstr("arm.model"));
  // A billion laughs: entities of a document's own stay text.
  EXPECT_THAT(Refusal("<!DOCTYPE r [<!ENTITY a \"1\"><!ENTITY b \"&a;&a;\">]><robot><link "
                      "name=\"&b;\"/></robot>",
                      {"elbow"}),
              HasSubstr("has no joint 'elbow'"));
}

// A long chain of links that is within the bound, through MuJoCo.
TEST_F(UrdfDamageTest, AThousandLinksAreRead) {
  std::string text = "<robot><link name=\"0\"/>";
  for (int i = 1; i < 1000; ++i)
    absl::StrAppend(&text, "<link name=\"", i, "\"><inertial><mass value=\"1\"/></inertial></link>",
                    "<joint name=\"j", i, "\" type=\"", i == 1 ? "continuous" : "fixed",
                    "\"><origin xyz=\"0.001 0 0\"/><parent link=\"", i - 1, "\"/><child link=\"", i,
                    "\"/><axis xyz=\"0 1 0\"/></joint>");
  const auto loaded = Load(text + "</robot>", {"j1"});
  ASSERT_TRUE(loaded.ok()) << loaded.status();
  EXPECT_EQ(loaded->model->nbody, 1001) << "and the world";
}

}  // namespace
}  // namespace robostress::calibration
