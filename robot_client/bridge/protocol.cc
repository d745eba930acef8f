#include "robot_client/bridge/protocol.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "nlohmann/json.hpp"

namespace robostress::bridge {
namespace {

static_assert(std::endian::native == std::endian::little);
constexpr uint8_t kMagic[4] = {'R', 'S', 'B', 'R'};
constexpr size_t kMostText = 200;  // characters of a driver's own words that are shown

template <class T>
void Put(const T& value, uint8_t*& at) {
  std::memcpy(at, &value, sizeof value);
  at += sizeof value;
}

template <class T>
T Get(const uint8_t*& at) {
  T value;
  std::memcpy(&value, at, sizeof value);
  at += sizeof value;
  return value;
}

void PutValues(const ArmVector& values, int axes, uint8_t*& at) {
  for (int i = 0; i < axes; ++i) Put(values[i], at);
}

bool GetValues(int axes, const uint8_t*& at, ArmVector& values) {
  bool fine = true;
  values.fill(0);
  for (int i = 0; i < axes; ++i) {
    values[i] = Get<double>(at);
    fine = fine && std::abs(values[i]) <= kMostValue;  // false for a NaN
  }
  return fine;
}

absl::Status Wrong(const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat("the driver's welcome: ", what));
}

// A driver's text goes to a terminal: printable, and not for ever.
std::string Printable(std::string text) {
  if (text.size() > kMostText) text.resize(kMostText);
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 32 || c == 127) c = ' ';
  }
  return text;
}

nlohmann::json Parsed(const std::string& text) {
  return nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false);
}

// Reads fields of one JSON object and keeps the first complaint.
class Fields {
 public:
  explicit Fields(const nlohmann::json& object) : object_(object) {}

  void Truth(const char* key, bool& value) {
    const auto found = object_.find(key);
    if (found == object_.end()) return Fail(absl::StrCat(key, " is missing; true or false"));
    if (!found->is_boolean())
      return Fail(absl::StrCat(key, " is ", Shown(*found), ", must be true or false"));
    value = found->get<bool>();
  }
  void Number(const char* key, double least, double most, double& value) {
    const auto found = object_.find(key);
    if (found == object_.end()) return Fail(absl::StrCat(key, " is missing; a number"));
    if (!found->is_number() || !(found->get<double>() >= least && found->get<double>() <= most))
      return Fail(absl::StrCat(key, " is ", Shown(*found), ", must be ", least, " to ", most));
    value = found->get<double>();
  }
  void Text(const char* key, std::string& value) {
    const auto found = object_.find(key);
    if (found == object_.end() || !found->is_string())
      return Fail(absl::StrCat(key, " is missing, or no text"));
    value = Printable(found->get<std::string>());
  }
  void Fail(const std::string& what) {
    if (status_.ok()) status_ = Wrong(what);
  }
  const absl::Status& status() const { return status_; }

 private:
  static std::string Shown(const nlohmann::json& value) {
    return Printable(value.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace));
  }
  const nlohmann::json& object_;
  absl::Status status_;
};

}  // namespace

void EncodeHeader(const FrameHeader& header, uint8_t* out) {
  std::memcpy(out, kMagic, sizeof kMagic);
  out += sizeof kMagic;
  Put(kVersion, out);
  Put(static_cast<uint8_t>(header.kind), out);
  Put(header.size, out);
  Put(header.sequence, out);
}

size_t EncodeState(const StateFrame& state, uint64_t sequence,
                   std::array<uint8_t, kMostFrame>& out) {
  const size_t size = kStateBytes + 24 * static_cast<size_t>(state.axes);
  EncodeHeader({FrameKind::kState, static_cast<uint16_t>(size), sequence}, out.data());
  uint8_t* at = out.data() + kHeaderBytes;
  Put(state.stamp_ns, at);
  Put(state.sent_ns, at);
  Put(state.command, at);
  Put(state.command_ns, at);
  Put(state.flags, at);
  Put(state.faults, at);
  for (const ArmVector* values : {&state.position, &state.velocity, &state.effort})
    PutValues(*values, state.axes, at);
  return kHeaderBytes + size;
}

size_t EncodeCommand(const CommandFrame& command, uint64_t sequence,
                     std::array<uint8_t, kMostFrame>& out) {
  const size_t size = kCommandBytes + 8 * static_cast<size_t>(command.axes);
  EncodeHeader({FrameKind::kCommand, static_cast<uint16_t>(size), sequence}, out.data());
  uint8_t* at = out.data() + kHeaderBytes;
  Put(command.stamp_ns, at);
  Put(command.state, at);
  Put(static_cast<uint32_t>(command.mode), at);
  Put(uint32_t{0}, at);
  Put(command.gripper_effort, at);
  PutValues(command.position, command.axes, at);
  return kHeaderBytes + size;
}

std::vector<uint8_t> EncodeText(FrameKind kind, uint64_t sequence, const std::string& text) {
  std::vector<uint8_t> out(kHeaderBytes + text.size());
  EncodeHeader({kind, static_cast<uint16_t>(text.size()), sequence}, out.data());
  std::memcpy(out.data() + kHeaderBytes, text.data(), text.size());
  return out;
}

const char* DecodedName(Decoded decoded) {
  switch (decoded) {
    case Decoded::kFrame:
      return "a frame";
    case Decoded::kMore:
      return "part of a frame";
    case Decoded::kMagic:
      return "bytes that are no frame";
    case Decoded::kVersion:
      return "a frame of another version";
    case Decoded::kKind:
      return "a frame of an unknown kind";
    case Decoded::kLength:
      return "a frame of a wrong length";
    case Decoded::kNotFinite:
      return "a value that is no number";
  }
  return "?";
}

Decoded DecodeHeader(const uint8_t* data, size_t size, FrameHeader& header) {
  const size_t seen = std::min(size, sizeof kMagic);
  if (std::memcmp(data, kMagic, seen) != 0) return Decoded::kMagic;
  if (size > sizeof kMagic && data[sizeof kMagic] != kVersion) return Decoded::kVersion;
  if (size < kHeaderBytes) return Decoded::kMore;
  const uint8_t* at = data + sizeof kMagic + 1;
  const auto kind = Get<uint8_t>(at);
  if (kind < static_cast<uint8_t>(FrameKind::kHello) ||
      kind > static_cast<uint8_t>(FrameKind::kBye))
    return Decoded::kKind;
  header.kind = static_cast<FrameKind>(kind);
  header.size = Get<uint16_t>(at);
  header.sequence = Get<uint64_t>(at);
  if (header.size > kMostPayload) return Decoded::kLength;
  return size - kHeaderBytes < header.size ? Decoded::kMore : Decoded::kFrame;
}

Decoded DecodeState(const uint8_t* payload, size_t size, int axes, StateFrame& state) {
  if (axes < 0 || axes > kMostAxes || size != kStateBytes + 24 * static_cast<size_t>(axes))
    return Decoded::kLength;
  const uint8_t* at = payload;
  state.stamp_ns = Get<int64_t>(at);
  state.sent_ns = Get<int64_t>(at);
  state.command = Get<uint64_t>(at);
  state.command_ns = Get<int64_t>(at);
  state.flags = Get<uint32_t>(at);
  state.faults = Get<uint32_t>(at);
  state.axes = axes;
  bool fine = true;
  for (ArmVector* values : {&state.position, &state.velocity, &state.effort})
    fine = GetValues(axes, at, *values) && fine;
  return fine ? Decoded::kFrame : Decoded::kNotFinite;
}

Decoded DecodeCommand(const uint8_t* payload, size_t size, int axes, CommandFrame& command) {
  if (axes < 0 || axes > kMostAxes || size != kCommandBytes + 8 * static_cast<size_t>(axes))
    return Decoded::kLength;
  const uint8_t* at = payload;
  command.stamp_ns = Get<int64_t>(at);
  command.state = Get<uint64_t>(at);
  const auto mode = Get<uint32_t>(at);
  if (mode > static_cast<uint32_t>(CommandMode::kAcknowledge)) return Decoded::kKind;
  command.mode = static_cast<CommandMode>(mode);
  at += sizeof(uint32_t);
  command.gripper_effort = Get<double>(at);
  command.axes = axes;
  const bool fine = GetValues(axes, at, command.position);
  return fine && std::abs(command.gripper_effort) <= kMostValue ? Decoded::kFrame
                                                                : Decoded::kNotFinite;
}

const char* OnSilenceName(OnSilence on_silence) {
  switch (on_silence) {
    case OnSilence::kHold:
      return "hold";
    case OnSilence::kStop:
      return "stop";
    case OnSilence::kPowerOff:
      return "torque_off";
    case OnSilence::kNothing:
      return "nothing";
  }
  return "?";
}

absl::StatusOr<Welcome> ParseWelcome(const std::string& json) {
  const nlohmann::json root = Parsed(json);
  if (!root.is_object()) return Wrong("it is no JSON object");
  Welcome welcome;
  Fields fields(root);
  double protocol = 0;
  fields.Number("protocol", 0, 1000, protocol);
  welcome.protocol = static_cast<int>(protocol);
  fields.Text("driver", welcome.driver);
  fields.Text("robot", welcome.robot);
  fields.Truth("stop", welcome.stop);
  fields.Truth("hold", welcome.hold);
  fields.Truth("torque_off", welcome.torque_off);
  fields.Truth("measures_velocity", welcome.measures_velocity);
  fields.Truth("measures_effort", welcome.measures_effort);
  fields.Truth("simulated", welcome.simulated);
  fields.Number("watchdog_s", 0, 60, welcome.watchdog_s);
  fields.Number("state_hz", 0, 10000, welcome.state_hz);
  std::string clock, on_silence;
  fields.Text("clock", clock);
  fields.Text("on_silence", on_silence);
  if (root.contains("note")) fields.Text("note", welcome.note);
  if (!fields.status().ok()) return fields.status();
  if (clock != "monotonic" && clock != "none")
    return Wrong(absl::StrCat("clock is '", clock, "', must be monotonic or none"));
  welcome.monotonic = clock == "monotonic";
  bool known = false;
  for (const OnSilence each :
       {OnSilence::kHold, OnSilence::kStop, OnSilence::kPowerOff, OnSilence::kNothing}) {
    if (on_silence != OnSilenceName(each)) continue;
    welcome.on_silence = each;
    known = true;
  }
  if (!known)
    return Wrong(absl::StrCat("on_silence is '", on_silence,
                              "', must be hold, stop, torque_off or nothing"));
  const auto axes = root.find("axes");
  if (axes == root.end() || !axes->is_array() || axes->empty() || axes->size() > 64)
    return Wrong("axes is missing, or no list of names");
  for (const nlohmann::json& name : *axes) {
    if (!name.is_string()) return Wrong("axes holds something that is no name");
    welcome.axes.push_back(Printable(name.get<std::string>()));
  }
  welcome.units.resize(welcome.axes.size());
  const auto units = root.find("units");
  if (units == root.end()) return welcome;
  if (!units->is_object()) return Wrong("units is no JSON object");
  for (size_t i = 0; i < axes->size(); ++i) {
    const auto unit = units->find((*axes)[i].get<std::string>());
    if (unit == units->end()) continue;
    const std::string name = unit->is_string() ? unit->get<std::string>() : "";
    if (name == "radians" || name == "degrees" || name == "metres") {
      welcome.units[i].name = name;
    } else if (unit->is_array() && unit->size() == 2 && (*unit)[0].is_number() &&
               (*unit)[1].is_number() && (*unit)[0].get<double>() < (*unit)[1].get<double>()) {
      welcome.units[i].range = {(*unit)[0].get<double>(), (*unit)[1].get<double>()};
    } else {
      return Wrong(absl::StrCat("units.", welcome.axes[i], " is ", Printable(unit->dump()),
                                ", must be radians, degrees, metres or the two ends of a range"));
    }
  }
  return welcome;
}

std::string HelloText(const std::string& robot, const std::vector<std::string>& axes, bool gripper,
                      double rate_hz) {
  return nlohmann::json{{"protocol", kVersion},
                        {"client", "robot_client"},
                        {"robot", robot},
                        {"axes", axes},
                        {"gripper", gripper ? nlohmann::json(axes.back()) : nlohmann::json()},
                        {"rate_hz", rate_hz}}
      .dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
}

std::string ParseRefusal(const std::string& json) {
  const nlohmann::json root = Parsed(json);
  if (root.is_object() && root.contains("reason") && root["reason"].is_string())
    return Printable(root["reason"].get<std::string>());
  return Printable(json);
}

}  // namespace robostress::bridge
