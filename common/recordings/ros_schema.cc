#include "common/recordings/ros_schema.h"

#include <algorithm>
#include <map>
#include <optional>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

using Kind = RosField::Kind;

constexpr size_t kMostText = size_t{1} << 20;
constexpr size_t kMostTypes = 1000;
constexpr size_t kMostFields = 10'000;
constexpr int kDeepest = 32;
constexpr size_t kShortestRule = 20;  // of a line of '='; writers use 80

const std::vector<std::pair<absl::string_view, Kind>>& Primitives() {
  static const auto& primitives = *new std::vector<std::pair<absl::string_view, Kind>>{
      {"bool", Kind::kBool},       {"int8", Kind::kInt8},     {"uint8", Kind::kUint8},
      {"byte", Kind::kUint8},      {"char", Kind::kUint8},    {"int16", Kind::kInt16},
      {"uint16", Kind::kUint16},   {"int32", Kind::kInt32},   {"uint32", Kind::kUint32},
      {"int64", Kind::kInt64},     {"uint64", Kind::kUint64}, {"float32", Kind::kFloat32},
      {"float64", Kind::kFloat64}, {"string", Kind::kString}, {"wstring", Kind::kWideString}};
  return primitives;
}

absl::Status Wrong(absl::string_view type, absl::string_view line, absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("schema of ", type, ": line '", line, "' ", what));
}

// "pkg/msg/Type" and "pkg/Type" are the same.
std::string PlainName(absl::string_view name) {
  std::vector<absl::string_view> parts = absl::StrSplit(name, '/');
  if (parts.size() == 3 && parts[1] == "msg") return absl::StrCat(parts[0], "/", parts[2]);
  return std::string(name);
}

// A number of at most nine digits behind the front of `text`; -1: none.
int64_t Length(absl::string_view text) {
  int64_t value = -1;
  if (text.empty() || text.size() > 9 || !absl::SimpleAtoi(text, &value) || value < 0) return -1;
  return value;
}

// "[]", "[7]", "[<=7]" at the end of `type`, which is taken off. False: it is none of these.
bool TakeArray(absl::string_view* type, RosField* field) {
  if (type->empty() || type->back() != ']') return true;
  const size_t open = type->rfind('[');
  if (open == absl::string_view::npos) return false;
  const absl::string_view inside = type->substr(open + 1, type->size() - open - 2);
  type->remove_suffix(type->size() - open);
  field->array = true;
  if (inside.empty()) return true;
  int64_t& length = inside.substr(0, 2) == "<=" ? field->most : field->fixed;
  length = Length(inside.substr(0, 2) == "<=" ? inside.substr(2) : inside);
  return length > 0;
}

// "string<=10".
bool TakeBound(absl::string_view* type, RosField* field) {
  const size_t bound = type->find("<=");
  if (bound == absl::string_view::npos) return true;
  field->longest = Length(type->substr(bound + 2));
  *type = type->substr(0, bound);
  return field->longest >= 0 && (*type == "string" || *type == "wstring");
}

struct Section {
  std::string name;
  std::vector<absl::string_view> lines;
};

std::vector<Section> Sections(absl::string_view name, absl::string_view text) {
  std::vector<Section> sections = {{PlainName(name), {}}};
  bool behind_rule = false;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    line = absl::StripAsciiWhitespace(line);
    if (line.size() >= kShortestRule && line.find_first_not_of('=') == absl::string_view::npos) {
      behind_rule = true;
    } else if (behind_rule && absl::StartsWith(line, "MSG:")) {
      sections.push_back({PlainName(absl::StripAsciiWhitespace(line.substr(4))), {}});
      behind_rule = false;
    } else {
      sections.back().lines.push_back(line);
    }
  }
  return sections;
}

// The field of a line; none where it holds a constant or nothing. A struct's name is put in `of`.
absl::StatusOr<std::optional<RosField>> FieldOfLine(const Section& section, absl::string_view line,
                                                    std::string* of) {
  const size_t blank = line.find_first_of(" \t");
  if (line.empty() || line.front() == '#') return std::nullopt;
  if (blank == absl::string_view::npos) return Wrong(section.name, line, "names no field");
  absl::string_view type = line.substr(0, blank);
  const absl::string_view rest = absl::StripLeadingAsciiWhitespace(line.substr(blank));
  const size_t end = std::min(rest.find_first_of(" \t=#"), rest.size());
  const absl::string_view after = absl::StripLeadingAsciiWhitespace(rest.substr(end));
  if (absl::StartsWith(after, "=")) return std::nullopt;
  RosField field;
  field.name = std::string(rest.substr(0, end));
  if (field.name.empty()) return Wrong(section.name, line, "names no field");
  if (!TakeArray(&type, &field)) return Wrong(section.name, line, "has an array of no length");
  if (!TakeBound(&type, &field)) return Wrong(section.name, line, "has a bound that is none");
  for (const auto& [word, kind] : Primitives()) {
    field.kind = kind;
    if (word == type) return field;
  }
  field.kind = Kind::kStruct;
  *of = type == "Header" ? "std_msgs/Header" : PlainName(type);
  if (of->find('/') == std::string::npos)
    *of = absl::StrCat(section.name.substr(0, section.name.find('/')), "/", *of);
  return field;
}

}  // namespace

absl::StatusOr<RosSchema> RosSchema::Parse(absl::string_view name, absl::string_view text) {
  if (text.size() > kMostText)
    return absl::InvalidArgumentError(
        absl::StrCat("schema of ", name, ": is ", text.size(), " bytes long, at most ", kMostText));
  const std::vector<Section> sections = Sections(name, text);
  if (sections.size() > kMostTypes)
    return absl::InvalidArgumentError(absl::StrCat("schema of ", name, ": has ", sections.size(),
                                                   " types, at most ", kMostTypes));
  std::map<std::string, size_t> index;
  for (size_t i = 0; i < sections.size(); ++i) index.emplace(sections[i].name, i);
  RosSchema schema;
  size_t fields = 0;
  for (const Section& section : sections) {
    RosType type;
    type.name = section.name;
    for (const absl::string_view line : section.lines) {
      std::string of;
      RS_ASSIGN_OR_RETURN(std::optional<RosField> field, FieldOfLine(section, line, &of));
      if (!field) continue;
      if (field->kind == Kind::kStruct) {
        const auto found = index.find(of);
        if (found == index.end())
          return Wrong(section.name, line,
                       absl::StrCat("needs ", of, ", which is not in the text"));
        field->type = found->second;
      }
      if (++fields > kMostFields) return Wrong(section.name, line, "is one field too many");
      type.fields.push_back(*std::move(field));
    }
    // A structure has one member at least (rosidl's structure_needs_at_least_one_member).
    if (type.fields.empty()) {
      type.fields.emplace_back();
      type.fields.back().name = "structure_needs_at_least_one_member";
      type.fields.back().kind = Kind::kUint8;
    }
    schema.types_.push_back(std::move(type));
  }
  std::vector<char> state(schema.types_.size(), 0);
  RS_RETURN_IF_ERROR(schema.CheckNesting(0, 0, &state));
  return schema;
}

// `state`: 0 unseen, 1 on the way, 2 in order.
absl::Status RosSchema::CheckNesting(size_t type, int depth, std::vector<char>* state) const {
  if ((*state)[type] == 2) return absl::OkStatus();
  if ((*state)[type] == 1 || depth > kDeepest)
    return absl::InvalidArgumentError(
        absl::StrCat("schema of ", types_[type].name, ": contains itself, or nests too deeply"));
  (*state)[type] = 1;
  for (const RosField& field : types_[type].fields) {
    if (field.kind == Kind::kStruct) RS_RETURN_IF_ERROR(CheckNesting(field.type, depth + 1, state));
  }
  (*state)[type] = 2;
  return absl::OkStatus();
}

}  // namespace robostress
