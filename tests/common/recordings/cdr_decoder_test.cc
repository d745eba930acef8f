#include "common/recordings/cdr_decoder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "common/random.h"
#include "common/recordings/joint_messages.h"
#include "tests/common/recordings/recording_bytes.h"

namespace robostress::recording_test {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

RosSchema SchemaOf(const std::string& text, const std::string& name = "test_msgs/msg/Root") {
  auto schema = RosSchema::Parse(name, text);
  EXPECT_TRUE(schema.ok()) << schema.status();
  return *std::move(schema);
}

std::string WhyNoSchema(const std::string& text) {
  const auto schema = RosSchema::Parse("test_msgs/msg/Root", text);
  EXPECT_FALSE(schema.ok()) << text;
  return std::string(schema.status().message());
}

std::string WhyNoMessage(const RosSchema& schema, const std::string& message) {
  const auto value = DecodeCdr(schema, message);
  EXPECT_FALSE(value.ok());
  return std::string(value.status().message());
}

TEST(RosSchemaTest, ReadsTypesArraysBoundsDefaultsAndPassesOverConstants) {
  const RosSchema schema = SchemaOf(
      "# comment\nuint8 A=1\nstring NAME = \"x # y\"\nint32 count 5\nstring<=10 label \"a=b\"\n"
      "float64[3] fixed\nfloat32[<=4] bounded [1.0, 2.0]\nstring<=8[] words  # said\n"
      "Inner inner\nother_msgs/msg/Far[] far\nHeader header\n" +
      std::string(kRule) + "MSG: test_msgs/Inner\nbool flag\n" + kRule +
      "MSG: other_msgs/Far\n# nothing\n" + kRule + "MSG: std_msgs/Header\nstring frame_id\n");
  const std::vector<RosField>& fields = schema.types()[0].fields;
  ASSERT_EQ(fields.size(), 8);
  EXPECT_EQ(fields[0].name, "count");
  EXPECT_EQ(fields[0].kind, RosField::Kind::kInt32);
  EXPECT_EQ(fields[1].longest, 10);
  EXPECT_EQ(fields[2].fixed, 3);
  EXPECT_EQ(fields[3].most, 4);
  EXPECT_EQ(fields[4].longest, 8);
  EXPECT_TRUE(fields[4].array);
  EXPECT_EQ(schema.types()[fields[5].type].name, "test_msgs/Inner");
  EXPECT_EQ(schema.types()[fields[6].type].fields[0].name, "structure_needs_at_least_one_member");
  EXPECT_EQ(schema.types()[fields[7].type].name, "std_msgs/Header");
}

TEST(RosSchemaTest, SaysWhatIsWrong) {
  EXPECT_THAT(WhyNoSchema("Missing x\n"), HasSubstr("needs test_msgs/Missing"));
  EXPECT_THAT(WhyNoSchema("float64[0] x\n"), HasSubstr("an array of no length"));
  EXPECT_THAT(WhyNoSchema("float64[-1] x\n"), HasSubstr("an array of no length"));
  EXPECT_THAT(WhyNoSchema("float64] x\n"), HasSubstr("an array of no length"));
  EXPECT_THAT(WhyNoSchema("int32<=4 x\n"), HasSubstr("a bound that is none"));
  EXPECT_THAT(WhyNoSchema("int32\n"), HasSubstr("names no field"));
  EXPECT_THAT(WhyNoSchema("Root x\n"), HasSubstr("contains itself"));
  EXPECT_THAT(WhyNoSchema(std::string(2 << 20, '#')), HasSubstr("at most 1048576"));
}

// The same fields in both byte orders and both alignments.
TEST(CdrDecoderTest, AlignsAndSwapsAsTheEncapsulationSays) {
  const RosSchema schema = SchemaOf(
      "uint8 a\nfloat64 b\nint16 c\nint64 d\nstring e\nfloat32[2] f\nuint16[] g\nInner[] h\nbool "
      "i\n" +
      std::string(kRule) + "MSG: test_msgs/Inner\nint8 x\nuint32 y\n");
  for (const bool little : {true, false}) {
    for (const bool second : {true, false}) {
      CdrBytes bytes(little, second);
      bytes.Add(uint8_t{200}).Add(0.1).Add(int16_t{-3}).Add(int64_t{-5'000'000'000}).Text("héllo");
      bytes.Add(1.5F)
          .Add(-2.5F)
          .Add(uint32_t{3})
          .Add(uint16_t{1})
          .Add(uint16_t{2})
          .Add(uint16_t{65535});
      bytes.Add(uint32_t{2})
          .Add(int8_t{-1})
          .Add(uint32_t{4'000'000'000})
          .Add(int8_t{7})
          .Add(uint32_t{9});
      bytes.Add(uint8_t{1});
      const auto value = DecodeCdr(schema, bytes.Message());
      ASSERT_TRUE(value.ok()) << value.status() << " little " << little << " second " << second;
      ASSERT_EQ(value->items.size(), 9);
      EXPECT_THAT(value->items[0].numbers, ElementsAre(200));
      EXPECT_THAT(value->items[1].numbers, ElementsAre(0.1));
      EXPECT_THAT(value->items[2].numbers, ElementsAre(-3));
      EXPECT_THAT(value->items[3].numbers, ElementsAre(-5e9));
      EXPECT_THAT(value->items[4].texts, ElementsAre("héllo"));
      EXPECT_THAT(value->items[5].numbers, ElementsAre(1.5, -2.5));
      EXPECT_THAT(value->items[6].numbers, ElementsAre(1, 2, 65535));
      ASSERT_EQ(value->items[7].items.size(), 2);
      EXPECT_THAT(value->items[7].items[0].items[0].numbers, ElementsAre(-1));
      EXPECT_THAT(value->items[7].items[0].items[1].numbers, ElementsAre(4e9));
      EXPECT_THAT(value->items[7].items[1].items[1].numbers, ElementsAre(9));
      EXPECT_THAT(value->items[8].numbers, ElementsAre(1));
    }
  }
}

TEST(CdrDecoderTest, BelievesNoCountThatTheBytesDoNotHold) {
  const RosSchema numbers = SchemaOf("float64[] x\n");
  EXPECT_THAT(WhyNoMessage(numbers, CdrBytes().Add(uint32_t{4'000'000'000}).Message()),
              HasSubstr("field x has 4000000000 entries, 0 bytes are left"));
  const RosSchema bytes = SchemaOf("uint8[] x\n");
  EXPECT_THAT(WhyNoMessage(bytes, CdrBytes().Add(uint32_t{2'000'000}).Message() +
                                      std::string(2'000'000, 'x')),
              HasSubstr("at most 1000000"));
  const RosSchema nested =
      SchemaOf("A[1000] a\n" + std::string(kRule) + "MSG: test_msgs/A\nB[1000] b\n" + kRule +
               "MSG: test_msgs/B\nC[1000] c\n" + kRule + "MSG: test_msgs/C\n");
  EXPECT_THAT(WhyNoMessage(nested, CdrBytes().Message() + std::string(100'000, 'x')),
              HasSubstr("bytes"));
  const RosSchema text = SchemaOf("string<=3 x\nfloat64[<=2] y\n");
  EXPECT_THAT(WhyNoMessage(text, CdrBytes().Text("four").Message()),
              HasSubstr("field x is a text of 4 bytes, its type allows 3"));
  EXPECT_THAT(WhyNoMessage(text, CdrBytes().Text("").Numbers({1, 2, 3}).Message()),
              HasSubstr("field y has 3 entries, its type allows 2"));
  EXPECT_THAT(WhyNoMessage(text, CdrBytes().Add(uint32_t{99}).Message()),
              HasSubstr("field x is a text of 99 bytes, 0 are left"));
}

TEST(CdrDecoderTest, RefusesOtherEncapsulationsAndAnotherMessagesSchema) {
  const RosSchema schema = SchemaOf("int32 x\n");
  std::string message = CdrBytes().Add(int32_t{1}).Message();
  message[1] = 3;
  EXPECT_THAT(WhyNoMessage(schema, message), HasSubstr("its kind is 3"));
  EXPECT_THAT(WhyNoMessage(schema, "abc"), HasSubstr("has 3 bytes, 4 are needed"));
  EXPECT_THAT(WhyNoMessage(schema, CdrBytes().Add(int32_t{1}).Add(1.0).Message()),
              HasSubstr("are left behind the last field"));
  EXPECT_THAT(WhyNoMessage(SchemaOf("wstring x\n"), CdrBytes().Add(uint32_t{1}).Message()),
              HasSubstr("wstring"));
}

absl::StatusOr<JointMessage> JointStateOf(const JointStateFields& fields) {
  const RosSchema schema = SchemaOf(JointStateText(), "sensor_msgs/msg/JointState");
  const auto value = DecodeCdr(schema, JointStateBytes(fields));
  if (!value.ok()) return value.status();
  return ReadJointMessage(JointMessageKind::kJointState, schema, *value);
}

TEST(JointMessagesTest, TakesArraysOfJointStateByName) {
  const auto message = JointStateOf({7'000'000'005, {"b", "a"}, {1, 2}, {}, {5, 6}});
  ASSERT_TRUE(message.ok()) << message.status();
  EXPECT_TRUE(message->stamped);
  EXPECT_EQ(message->stamp_ns, 7'000'000'005);
  ASSERT_EQ(message->readings.size(), 4);
  EXPECT_EQ(message->readings[0].joint, "b");
  EXPECT_EQ(message->readings[3].quantity, JointQuantity::kEffort);
  EXPECT_EQ(message->readings[3].value, 6);
}

TEST(JointMessagesTest, RefusesArraysThatDoNotFitTheNames) {
  EXPECT_THAT(std::string(JointStateOf({1, {"a", "b"}, {1}}).status().message()),
              HasSubstr("field position has 1 numbers for 2 names"));
  EXPECT_THAT(std::string(JointStateOf({1, {"a", "a"}, {1, 2}}).status().message()),
              HasSubstr("field name has 'a' twice"));
  const auto unstamped = JointStateOf({0, {"a"}, {1}});
  ASSERT_TRUE(unstamped.ok());
  EXPECT_FALSE(unstamped->stamped) << "a stamp of 0 is none";
}

// Found by a fuzzer: the seconds of such a schema passed what nanoseconds can count.
TEST(JointMessagesTest, RefusesStampsThatNoClockOfRosCanHave) {
  std::string text = JointStateText();
  text.replace(text.find("int32 sec\n"), 9, "float64 sec");
  const RosSchema schema = SchemaOf(text, "sensor_msgs/msg/JointState");
  const auto why = [&](double sec, uint32_t nanosec) {
    CdrBytes bytes;
    bytes.Add(sec).Add(nanosec).Text("").Texts({}).Numbers({}).Numbers({}).Numbers({});
    const auto value = DecodeCdr(schema, bytes.Message());
    EXPECT_TRUE(value.ok()) << value.status();
    return std::string(
        ReadJointMessage(JointMessageKind::kJointState, schema, *value).status().message());
  };
  EXPECT_THAT(why(1e11, 0), HasSubstr("header.stamp.sec is 1e+11"));
  EXPECT_THAT(why(std::nan(""), 0), HasSubstr("header.stamp.sec is nan"));
  EXPECT_THAT(why(1, 1'000'000'000), HasSubstr("header.stamp.nanosec is 1e+09"));
  EXPECT_EQ(why(1, 999'999'999), "");
}

void AddPoint(CdrBytes* bytes, std::vector<double> positions, std::vector<double> velocities) {
  bytes->Numbers(positions).Numbers(velocities).Numbers({}).Numbers({});
  bytes->Add(int32_t{0}).Add(uint32_t{0});
}

// The layouts of control_msgs' tags, by the definitions that go with them.
TEST(JointMessagesTest, ReadsControllerStatesOfEveryLayout) {
  const std::vector<std::string> definitions = KnownDefinitions(JointMessageKind::kControllerState);
  const struct {
    int points;  // reference, feedback, error, output, desired, actual; or desired, actual, error
    bool multi, factor;
  } layouts[] = {
      {4, true, true}, {4, true, false}, {6, true, false}, {3, true, false}, {3, false, false}};
  ASSERT_EQ(definitions.size(), std::size(layouts));
  for (size_t layout = 0; layout < std::size(layouts); ++layout) {
    const auto& [points, multi, factor] = layouts[layout];
    CdrBytes bytes;
    bytes.Add(int32_t{3}).Add(uint32_t{4}).Text("").Texts({"a", "b"});
    AddPoint(&bytes, {1, 2}, {});        // reference or desired
    AddPoint(&bytes, {3, 4}, {0.5, 0});  // feedback or actual
    AddPoint(&bytes, {}, {});            // error
    if (points > 3) AddPoint(&bytes, {}, {});
    if (points > 4) AddPoint(&bytes, {9, 9}, {}), AddPoint(&bytes, {9, 9}, {});
    if (multi) bytes.Texts({});
    for (int i = 0; multi && i < points; ++i) {
      bytes.Add(uint32_t{0}).Add(uint32_t{0}).Add(uint32_t{0});
      bytes.Add(int32_t{0}).Add(uint32_t{0});
    }
    if (factor) bytes.Add(1.0);
    const RosSchema schema =
        SchemaOf(definitions[layout], "control_msgs/msg/JointTrajectoryControllerState");
    const auto value = DecodeCdr(schema, bytes.Message());
    ASSERT_TRUE(value.ok()) << value.status() << " layout " << layout;
    const auto message = ReadJointMessage(JointMessageKind::kControllerState, schema, *value);
    ASSERT_TRUE(message.ok()) << message.status();
    std::map<std::string, double> found;
    for (const JointReading& reading : message->readings)
      found[std::string(QuantityName(reading.quantity)) + " " + reading.joint] = reading.value;
    EXPECT_THAT(found, ElementsAre(std::pair("command a", 1.0), std::pair("command b", 2.0),
                                   std::pair("position a", 3.0), std::pair("position b", 4.0),
                                   std::pair("velocity a", 0.5), std::pair("velocity b", 0.0)));
    for (size_t other = 0; other < definitions.size(); ++other) {
      if (other == layout) continue;
      const RosSchema wrong =
          SchemaOf(definitions[other], "control_msgs/msg/JointTrajectoryControllerState");
      EXPECT_FALSE(DecodeCdr(wrong, bytes.Message()).ok())
          << "layout " << layout << " passes for " << other;
    }
  }
}

// Whatever schema and bytes are, they are read or refused.
TEST(CdrDecoderTest, BearsChangedSchemasAndMessages) {
  const std::string text = JointStateText();
  const std::string message = JointStateBytes({7, {"a", "b"}, {1, 2}, {3, 4}, {5, 6}});
  RandomStream random(StreamKey("cdr"));
  int read = 0, refused = 0;
  for (int i = 0; i < 40000; ++i) {
    std::string changed_text = text, changed = message;
    for (int k = random.UniformInt(3); k > 0; --k)
      changed_text[static_cast<size_t>(random.UniformInt(static_cast<int>(text.size())))] =
          "[]<=/ \n#9a"[random.UniformInt(11)];
    for (int k = random.UniformInt(3); k > 0; --k)
      changed[static_cast<size_t>(random.UniformInt(static_cast<int>(changed.size())))] =
          static_cast<char>(random.UniformInt(256));
    if (random.UniformInt(4) == 0)
      changed.resize(static_cast<size_t>(random.UniformInt(static_cast<int>(changed.size()))));
    const auto schema = RosSchema::Parse("sensor_msgs/msg/JointState", changed_text);
    const auto value = schema.ok() ? DecodeCdr(*schema, changed) : schema.status();
    if (value.ok()) {
      const auto joints = ReadJointMessage(JointMessageKind::kJointState, *schema, *value);
      if (joints.ok()) {
        EXPECT_LE(joints->readings.size(), 3 * message.size());
      }
    }
    ++(value.ok() ? read : refused);
  }
  EXPECT_GT(read, 1000);
  EXPECT_GT(refused, 1000);
}

}  // namespace
}  // namespace robostress::recording_test
