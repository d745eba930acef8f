#include "common/libero/bddl.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <map>
#include <numbers>
#include <optional>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/rollout/field_checks.h"
#include "common/status_macros.h"

namespace robostress::libero {
namespace {

constexpr double kFarthest = 100;          // [m] of a region; LIBERO's lie within 1
constexpr int kMaxDepth = 32;              // LIBERO's files nest 5 deep
constexpr size_t kMaxFileBytes = 1 << 16;  // LIBERO's largest file has 5 kB

// An s-expression: a word, or a list of s-expressions.
struct Node {
  bool is_list = false;
  std::string word;
  std::vector<Node> items;
  int line = 0;
};

class Parser {
 public:
  Parser(const std::string& file, std::string_view text) : file_(file), text_(text) {}

  absl::StatusOr<Node> Parse() {
    SkipSpace();
    if (pos_ == text_.size()) return Error(line_, "nothing in it; a BDDL file is (define ...)");
    RS_ASSIGN_OR_RETURN(Node root, ParseNode(0));
    SkipSpace();
    if (pos_ < text_.size())
      return Error(line_, absl::StrCat("'", Peek(), "' after the closing parenthesis"));
    return root;
  }

  absl::Status Error(int line, const std::string& what) const {
    return absl::InvalidArgumentError(absl::StrCat(file_, ":", line, ": ", what));
  }

 private:
  void SkipSpace() {
    while (pos_ < text_.size()) {
      const char c = text_[pos_];
      if (c == ';') {
        while (pos_ < text_.size() && text_[pos_] != '\n') ++pos_;
      } else if (std::isspace(static_cast<unsigned char>(c))) {
        line_ += c == '\n';
        ++pos_;
      } else {
        return;
      }
    }
  }

  std::string Peek() const { return std::string(text_.substr(pos_, 20)); }

  absl::StatusOr<Node> ParseNode(int depth) {
    if (depth > kMaxDepth) return Error(line_, absl::StrCat("lists nest deeper than ", kMaxDepth));
    SkipSpace();
    if (pos_ >= text_.size()) return Error(line_, "end of file inside a list: a ')' is missing");
    Node node;
    node.line = line_;
    if (text_[pos_] == ')') return Error(line_, "')' without its '('");
    if (text_[pos_] != '(') {
      const size_t begin = pos_;
      while (pos_ < text_.size() && text_[pos_] != '(' && text_[pos_] != ')' &&
             text_[pos_] != ';' && !std::isspace(static_cast<unsigned char>(text_[pos_]))) {
        ++pos_;
      }
      node.word = absl::AsciiStrToLower(std::string(text_.substr(begin, pos_ - begin)));
      if (!CheckUtf8("word", node.word).ok())
        return Error(line_, "a word that is not UTF-8; save the file in UTF-8");
      return node;
    }
    ++pos_;
    node.is_list = true;
    for (;;) {
      SkipSpace();
      if (pos_ < text_.size() && text_[pos_] == ')') {
        ++pos_;
        return node;
      }
      RS_ASSIGN_OR_RETURN(Node item, ParseNode(depth + 1));
      node.items.push_back(std::move(item));
    }
  }

  const std::string& file_;
  std::string_view text_;
  size_t pos_ = 0;
  int line_ = 1;
};

// LIBERO evaluates yaw values as Python; its files hold numbers and pi with an optional sign and
// divisor.
std::optional<double> EvaluateAngle(const std::string& word) {
  double value = 0;
  if (absl::SimpleAtod(word, &value))
    return std::isfinite(value) ? std::optional(value) : std::nullopt;
  std::string_view rest = word;
  auto skip = [&](std::string_view prefix) {
    const bool found = rest.starts_with(prefix);
    if (found) rest.remove_prefix(prefix.size());
    return found;
  };
  const double sign = skip("-") ? -1 : 1;
  skip("np.");
  if (!skip("pi")) return std::nullopt;
  double divisor = 1;
  if (skip("/")) {
    if (!absl::SimpleAtod(std::string(rest), &divisor) || !(divisor > 0)) return std::nullopt;
  } else if (!rest.empty()) {
    return std::nullopt;
  }
  return sign * std::numbers::pi / divisor;
}

class Reader {
 public:
  Reader(const std::string& file, const Parser& parser) : parser_(parser) { problem_.file = file; }

  absl::StatusOr<BddlProblem> Read(const Node& root) {
    if (!root.is_list || root.items.empty() || root.items[0].word != "define") {
      return parser_.Error(root.line, "a BDDL problem starts with '(define (problem NAME)'");
    }
    for (size_t i = 1; i < root.items.size(); ++i) RS_RETURN_IF_ERROR(ReadSection(root.items[i]));
    if (problem_.name.empty()) return parser_.Error(root.line, "no (problem NAME)");
    if (problem_.goal.empty()) return parser_.Error(root.line, "no (:goal ...) or an empty one");
    return std::move(problem_);
  }

 private:
  absl::Status ReadSection(const Node& section) {
    if (!section.is_list || section.items.empty() || section.items[0].is_list) {
      return parser_.Error(
          section.line,
          absl::StrCat("expected a section such as (:objects ...), got '", section.word, "'"));
    }
    const std::string& kind = section.items[0].word;
    // The originals take the first of some and the last of others.
    if (const auto [before, fresh] = lines_.try_emplace(kind, section.line); !fresh) {
      return parser_.Error(section.line,
                           absl::StrCat("a second (", kind, " ...); the first is in line ",
                                        before->second, ": leave one of them out"));
    }
    if (kind == "problem") return ReadWord(section, problem_.name);
    if (kind == ":domain") {
      std::string domain;
      RS_RETURN_IF_ERROR(ReadWord(section, domain));
      if (domain != "robosuite") {
        return parser_.Error(section.line,
                             absl::StrCat("domain '", domain, "', expected 'robosuite'"));
      }
      return absl::OkStatus();
    }
    if (kind == ":requirements") return absl::OkStatus();
    if (kind == ":language") {
      std::vector<std::string> words;
      RS_RETURN_IF_ERROR(ReadWords(section, words));
      problem_.language = absl::StrJoin(words, " ");
      return absl::OkStatus();
    }
    if (kind == ":regions") return ReadRegions(section);
    if (kind == ":fixtures") return ReadGroups(section, problem_.fixtures);
    if (kind == ":objects") return ReadGroups(section, problem_.objects);
    if (kind == ":obj_of_interest") return ReadWords(section, problem_.objects_of_interest);
    if (kind == ":init") {
      for (size_t i = 1; i < section.items.size(); ++i) {
        RS_RETURN_IF_ERROR(ReadAtom(section.items[i], problem_.init));
      }
      return absl::OkStatus();
    }
    if (kind == ":goal") return ReadGoal(section);
    return parser_.Error(section.line,
                         absl::StrCat("unknown section '", kind,
                                      "'; known: problem :domain :requirements :language :regions "
                                      ":fixtures :objects :obj_of_interest :init :goal"));
  }

  absl::Status ReadWord(const Node& section, std::string& out) {
    if (section.items.size() != 2 || section.items[1].is_list) {
      return parser_.Error(section.line,
                           absl::StrCat("(", section.items[0].word, " ...) takes one word"));
    }
    out = section.items[1].word;
    return absl::OkStatus();
  }

  absl::Status ReadWords(const Node& section, std::vector<std::string>& out) {
    for (size_t i = 1; i < section.items.size(); ++i) {
      if (section.items[i].is_list) {
        return parser_.Error(section.items[i].line,
                             absl::StrCat(section.items[0].word, " holds words, not lists"));
      }
      out.push_back(section.items[i].word);
    }
    return absl::OkStatus();
  }

  absl::Status ReadGroups(const Node& section, std::vector<BddlGroup>& out) {
    BddlGroup group;
    for (size_t i = 1; i < section.items.size(); ++i) {
      const Node& item = section.items[i];
      if (item.is_list)
        return parser_.Error(item.line,
                             absl::StrCat(section.items[0].word, " holds words, not lists"));
      if (item.word != "-") {
        group.instances.push_back(item.word);
        continue;
      }
      if (i + 1 >= section.items.size() || section.items[i + 1].is_list) {
        return parser_.Error(item.line, "'-' without a category after it");
      }
      group.category = section.items[++i].word;
      group.line = item.line;
      if (group.instances.empty()) {
        return parser_.Error(item.line, absl::StrCat("category '", group.category,
                                                     "' without an instance before '-'"));
      }
      for (const BddlGroup& other : out) {
        if (other.category == group.category) {
          return parser_.Error(item.line,
                               absl::StrCat("category '", group.category, "' again (first on line ",
                                            other.line, "): list its instances before one '-'"));
        }
      }
      for (const std::string& instance : group.instances) {
        if (!instances_.insert(std::pair(instance, item.line)).second) {
          return parser_.Error(item.line, absl::StrCat("'", instance, "' is declared twice"));
        }
      }
      out.push_back(std::move(group));
      group = BddlGroup();
    }
    if (!group.instances.empty()) {
      return parser_.Error(section.line,
                           absl::StrCat("'", group.instances[0], "' without '- category'"));
    }
    return absl::OkStatus();
  }

  absl::Status ReadNumbers(const Node& list, size_t count, double* out) {
    if (!list.is_list || list.items.size() != count) {
      return parser_.Error(
          list.line, absl::StrCat("expected a list of ", count, " numbers, got ",
                                  list.is_list ? absl::StrCat(list.items.size()) : list.word));
    }
    for (size_t i = 0; i < count; ++i) {
      const std::optional<double> value =
          list.items[i].is_list ? std::nullopt : EvaluateAngle(list.items[i].word);
      if (!value)
        return parser_.Error(list.items[i].line,
                             absl::StrCat("'", list.items[i].word, "' is not a number"));
      out[i] = *value;
    }
    return absl::OkStatus();
  }

  absl::Status ReadRegions(const Node& section) {
    for (size_t i = 1; i < section.items.size(); ++i) {
      const Node& node = section.items[i];
      if (!node.is_list || node.items.empty() || node.items[0].is_list) {
        return parser_.Error(node.line, "a region is (NAME (:target INSTANCE) ...)");
      }
      BddlRegion region;
      region.line = node.line;
      for (size_t k = 1; k < node.items.size(); ++k)
        RS_RETURN_IF_ERROR(ReadRegionAttribute(node.items[k], region));
      if (region.target.empty()) {
        return parser_.Error(
            node.line, absl::StrCat("region '", node.items[0].word, "' has no (:target INSTANCE)"));
      }
      region.name = absl::StrCat(region.target, "_", node.items[0].word);
      if (const BddlRegion* first = problem_.FindRegion(region.name)) {
        return parser_.Error(
            region.line, absl::StrCat("region '", region.name, "' is defined in line ", first->line,
                                      " already; leave one of them"));
      }
      problem_.regions.push_back(std::move(region));
    }
    return absl::OkStatus();
  }

  absl::Status ReadRegionAttribute(const Node& node, BddlRegion& region) {
    if (!node.is_list || node.items.size() != 2 || node.items[0].is_list) {
      return parser_.Error(
          node.line,
          "a region's attribute is (:target ..), (:ranges ..), (:yaw_rotation ..) or (:rgba ..)");
    }
    const std::string& kind = node.items[0].word;
    const Node& value = node.items[1];
    if (kind == ":target") {
      if (value.is_list) return parser_.Error(value.line, ":target takes one word");
      region.target = value.word;
      return absl::OkStatus();
    }
    if (kind == ":rgba") return ReadNumbers(value, 4, region.rgba.data());
    if (kind == ":ranges") {
      if (!value.is_list) return parser_.Error(value.line, ":ranges takes a list of (x0 y0 x1 y1)");
      for (const Node& item : value.items) {
        std::array<double, 4> range;
        RS_RETURN_IF_ERROR(ReadNumbers(item, 4, range.data()));
        if (range[2] < range[0] || range[3] < range[1]) {
          return parser_.Error(item.line, absl::StrCat("range (", absl::StrJoin(range, " "),
                                                       ") has x1 < x0 or y1 < y0"));
        }
        if (std::any_of(range.begin(), range.end(),
                        [](double v) { return std::abs(v) > kFarthest; })) {
          return parser_.Error(item.line, absl::StrCat("range (", absl::StrJoin(range, " "),
                                                       ") is more than ", kFarthest, " m away"));
        }
        region.ranges.push_back(range);
      }
      return absl::OkStatus();
    }
    if (kind == ":yaw_rotation") {
      if (!value.is_list)
        return parser_.Error(value.line, ":yaw_rotation takes a list of (low high)");
      for (const Node& item : value.items)
        RS_RETURN_IF_ERROR(ReadNumbers(item, 2, region.yaw.data()));
      return absl::OkStatus();
    }
    return parser_.Error(node.line, absl::StrCat("unknown region attribute '", kind, "'"));
  }

  absl::Status CheckNoConnective(int line, const std::string& word) {
    static constexpr std::string_view kWords[] = {"and", "or", "not", "forall", "exists", "imply"};
    if (std::find(std::begin(kWords), std::end(kWords), word) == std::end(kWords))
      return absl::OkStatus();
    return parser_.Error(
        line, absl::StrCat("goal connective '", word,
                           "'; a goal is one 'and' of predicates, without other connectives"));
  }

  absl::Status ReadAtom(const Node& node, std::vector<BddlAtom>& out) {
    BddlAtom atom;
    atom.line = node.line;
    if (!node.is_list || node.items.empty()) {
      return parser_.Error(node.line,
                           absl::StrCat("expected (PREDICATE names ...), got '", node.word, "'"));
    }
    for (const Node& item : node.items) {
      if (item.is_list) {
        RS_RETURN_IF_ERROR(CheckNoConnective(item.line, atom.predicate));
        return parser_.Error(item.line, "a predicate's arguments are names, not lists");
      }
      if (atom.predicate.empty()) {
        atom.predicate = item.word;
      } else {
        atom.arguments.push_back(item.word);
      }
    }
    out.push_back(std::move(atom));
    return absl::OkStatus();
  }

  absl::Status ReadGoal(const Node& section) {
    if (section.items.size() != 2 || !section.items[1].is_list || section.items[1].items.empty()) {
      return parser_.Error(section.line, "a goal is (:goal (And (PREDICATE ...) ...))");
    }
    const Node& expression = section.items[1];
    const std::string& connective = expression.items[0].word;
    if (connective != "and") {
      RS_RETURN_IF_ERROR(CheckNoConnective(expression.line, connective));
      return ReadAtom(expression, problem_.goal);
    }
    for (size_t i = 1; i < expression.items.size(); ++i) {
      RS_RETURN_IF_ERROR(ReadAtom(expression.items[i], problem_.goal));
    }
    return absl::OkStatus();
  }

  const Parser& parser_;
  BddlProblem problem_;
  std::map<std::string, int> lines_;  // of the sections so far
  std::map<std::string, int> instances_;
};

}  // namespace

const BddlRegion* BddlProblem::FindRegion(std::string_view region_name) const {
  for (const BddlRegion& region : regions) {
    if (region.name == region_name) return &region;
  }
  return nullptr;
}

absl::StatusOr<BddlProblem> ParseBddl(const std::string& file, std::string_view text) {
  if (text.size() > kMaxFileBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": ", text.size(), " bytes, a BDDL file has at most ", kMaxFileBytes));
  }
  Parser parser(file, text);
  RS_ASSIGN_OR_RETURN(Node root, parser.Parse());
  return Reader(file, parser).Read(root);
}

absl::StatusOr<BddlProblem> ReadBddl(const std::string& file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  return ParseBddl(file, std::string(absl::StripPrefix(text, "\xEF\xBB\xBF")));  // editors' mark
}

}  // namespace robostress::libero
