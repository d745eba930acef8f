#include "common/libero/init_states.h"

#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <map>
#include <memory>
#include <variant>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/libero/zip_entry.h"
#include "common/status_macros.h"

namespace robostress::libero {
namespace {

static_assert(std::endian::native == std::endian::little, "the stored float64 are little-endian");

constexpr int64_t kMaxValues = int64_t{1} << 22;      // LIBERO's largest matrix has 12 thousand
constexpr size_t kMaxBytes = kMaxValues * 16 + 4096;  // two bytes of UTF-8 per stored byte
constexpr int kMaxOpcodes = 256;                      // LIBERO's pickles have about 50
constexpr double kBeyondLimit = 0.1;                  // [rad or m]
constexpr double kMostValue = 1e6;                    // LIBERO's largest is below 3
constexpr double kMostDistance = 100;                 // [m]
constexpr double kNormTolerance = 0.01;

absl::Status Bad(const std::string& file, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(
      file, ": ", what,
      "; expected a LIBERO .pruned_init or .npz file (take it anew from where it was published)"));
}

// What can be on the stack of the pickle of one matrix.
struct Value;
using Ref = std::shared_ptr<Value>;
struct None {};
struct MarkTag {};
struct Text {
  std::string_view utf8;  // in the pickle
};
struct Bytes {
  std::string data;
};
struct Tuple {
  std::vector<Ref> items;
};
enum class Name { kReconstruct, kNdarray, kDtype, kEncode };
struct Dtype {
  bool little_endian = false;
};
struct Array {
  bool built = false;
  int64_t rows = 0, columns = 0;
  std::string data;
};
struct Value {
  std::variant<None, MarkTag, bool, int64_t, Text, Bytes, Tuple, Name, Dtype, Array> v;
};

template <class T>
T* As(const Ref& ref) {
  return ref ? std::get_if<T>(&ref->v) : nullptr;
}

// utf8 -> latin1; false at a code point above 255 or a malformed sequence.
bool EncodeLatin1(std::string_view utf8, std::string& out) {
  out.clear();
  out.reserve(utf8.size());
  for (size_t i = 0; i < utf8.size(); ++i) {
    const uint8_t c = static_cast<uint8_t>(utf8[i]);
    if (c < 0x80) {
      out.push_back(static_cast<char>(c));
      continue;
    }
    if ((c != 0xc2 && c != 0xc3) || i + 1 >= utf8.size()) return false;
    const uint8_t next = static_cast<uint8_t>(utf8[++i]);
    if ((next & 0xc0) != 0x80) return false;
    out.push_back(static_cast<char>(((c & 3) << 6) | (next & 0x3f)));
  }
  return true;
}

class Unpickler {
 public:
  Unpickler(const std::string& file, std::string_view bytes) : file_(file), bytes_(bytes) {}

  absl::StatusOr<Array> Run() {
    if (bytes_.size() < 2 || bytes_[0] != '\x80' || bytes_[1] != 2)
      return Fail("the pickle is not protocol 2");
    pos_ = 2;
    for (int opcodes = 0; pos_ < bytes_.size(); ++opcodes) {
      at_ = pos_;
      // Bounds the depth of nested tuples as well, whose destruction recurses.
      if (opcodes == kMaxOpcodes) return Fail(absl::StrCat("more than ", kMaxOpcodes, " opcodes"));
      const uint8_t opcode = static_cast<uint8_t>(bytes_[pos_++]);
      if (opcode == '.') {
        Array* array = stack_.size() == 1 ? As<Array>(stack_.back()) : nullptr;
        if (array == nullptr || !array->built) return Fail("the pickle does not end on one matrix");
        return std::move(*array);
      }
      RS_RETURN_IF_ERROR(Step(opcode));
    }
    return Fail("the pickle ends without STOP");
  }

 private:
  absl::Status Fail(const std::string& what) const {
    return Bad(file_, absl::StrCat("byte ", at_, " of data.pkl: ", what));
  }

  absl::StatusOr<std::string_view> Take(size_t n) {
    if (bytes_.size() - pos_ < n)
      return Fail(absl::StrCat("needs ", n, " bytes, ", bytes_.size() - pos_, " are left"));
    std::string_view taken = bytes_.substr(pos_, n);
    pos_ += n;
    return taken;
  }

  template <class T>
  absl::StatusOr<T> TakeInt() {
    RS_ASSIGN_OR_RETURN(std::string_view raw, Take(sizeof(T)));
    T value;
    std::memcpy(&value, raw.data(), sizeof(T));
    return value;
  }

  template <class T>
  void Push(T value) {
    stack_.push_back(std::make_shared<Value>(Value{std::move(value)}));
  }

  absl::StatusOr<Ref> Pop() {
    if (stack_.empty() || As<MarkTag>(stack_.back())) return Fail("the stack is empty");
    Ref top = std::move(stack_.back());
    stack_.pop_back();
    return top;
  }

  absl::Status MakeTuple(size_t n) {
    Tuple tuple;
    tuple.items.resize(n);
    for (size_t i = n; i-- > 0;) {
      RS_ASSIGN_OR_RETURN(tuple.items[i], Pop());
    }
    Push(std::move(tuple));
    return absl::OkStatus();
  }

  absl::Status Step(uint8_t opcode) {
    switch (opcode) {
      case 'c':
        return Global();
      case 'q': {  // BINPUT
        RS_ASSIGN_OR_RETURN(uint8_t index, TakeInt<uint8_t>());
        if (stack_.empty()) return Fail("BINPUT on an empty stack");
        memo_[index] = stack_.back();
        return absl::OkStatus();
      }
      case 'h': {  // BINGET
        RS_ASSIGN_OR_RETURN(uint8_t index, TakeInt<uint8_t>());
        auto found = memo_.find(index);
        if (found == memo_.end()) return Fail(absl::StrCat("BINGET of unset slot ", index));
        stack_.push_back(found->second);
        return absl::OkStatus();
      }
      case 'K': {  // BININT1
        RS_ASSIGN_OR_RETURN(uint8_t value, TakeInt<uint8_t>());
        Push<int64_t>(value);
        return absl::OkStatus();
      }
      case 'M': {  // BININT2
        RS_ASSIGN_OR_RETURN(uint16_t value, TakeInt<uint16_t>());
        Push<int64_t>(value);
        return absl::OkStatus();
      }
      case 'J': {  // BININT
        RS_ASSIGN_OR_RETURN(int32_t value, TakeInt<int32_t>());
        Push<int64_t>(value);
        return absl::OkStatus();
      }
      case 'X': {  // BINUNICODE
        RS_ASSIGN_OR_RETURN(uint32_t length, TakeInt<uint32_t>());
        RS_ASSIGN_OR_RETURN(std::string_view text, Take(length));
        Push(Text{text});
        return absl::OkStatus();
      }
      case 'N':
        Push(None{});
        return absl::OkStatus();
      case 0x88:
        Push(true);
        return absl::OkStatus();
      case 0x89:
        Push(false);
        return absl::OkStatus();
      case '(':
        Push(MarkTag{});
        return absl::OkStatus();
      case 0x85:
        return MakeTuple(1);
      case 0x86:
        return MakeTuple(2);
      case 0x87:
        return MakeTuple(3);
      case 't': {
        size_t n = 0;
        while (n < stack_.size() && !As<MarkTag>(stack_[stack_.size() - 1 - n])) ++n;
        if (n == stack_.size()) return Fail("TUPLE without MARK");
        RS_RETURN_IF_ERROR(MakeTuple(n));
        stack_.erase(stack_.end() - 2);
        return absl::OkStatus();
      }
      case 'R':
        return Reduce();
      case 'b':
        return Build();
      default:
        return Fail(
            absl::StrFormat("opcode 0x%02x is not on the list of what a matrix needs", opcode));
    }
  }

  absl::Status Global() {
    std::string names[2];
    for (std::string& name : names) {
      const size_t newline = bytes_.find('\n', pos_);
      if (newline == std::string_view::npos || newline - pos_ > 64)
        return Fail("a name has no end");
      name = std::string(bytes_.substr(pos_, newline - pos_));
      pos_ = newline + 1;
    }
    const std::string name = names[0] + "." + names[1];
    if (name == "numpy.core.multiarray._reconstruct" ||
        name == "numpy._core.multiarray._reconstruct") {
      Push(Name::kReconstruct);
    } else if (name == "numpy.ndarray") {
      Push(Name::kNdarray);
    } else if (name == "numpy.dtype") {
      Push(Name::kDtype);
    } else if (name == "_codecs.encode") {
      Push(Name::kEncode);
    } else {
      return Fail(absl::StrCat("the name '", name, "' is not on the list of what a matrix needs"));
    }
    return absl::OkStatus();
  }

  absl::Status Reduce() {
    RS_ASSIGN_OR_RETURN(Ref argument, Pop());
    RS_ASSIGN_OR_RETURN(Ref callable, Pop());
    const Tuple* tuple = As<Tuple>(argument);
    const Name* name = As<Name>(callable);
    if (tuple == nullptr || name == nullptr)
      return Fail("REDUCE of something that is not a known name");
    const std::vector<Ref>& args = tuple->items;
    if (*name == Name::kEncode && args.size() == 2) {
      const Text* text = As<Text>(args[0]);
      const Text* codec = As<Text>(args[1]);
      Bytes encoded;
      // Honest pickles encode each text once; more would hold many times the file in memory.
      if (text) encoded_ += text->utf8.size();
      if (encoded_ > bytes_.size()) return Fail("encodes more text than the pickle holds");
      if (text && codec && codec->utf8 == "latin1" && EncodeLatin1(text->utf8, encoded.data)) {
        Push(std::move(encoded));
        return absl::OkStatus();
      }
      return Fail("the bytes of the matrix are not latin1 text");
    }
    if (*name == Name::kReconstruct && args.size() == 3) {
      const Name* type = As<Name>(args[0]);
      if (type && *type == Name::kNdarray) {
        Push(Array{});
        return absl::OkStatus();
      }
    }
    if (*name == Name::kDtype && args.size() == 3) {
      const Text* type = As<Text>(args[0]);
      if (type && type->utf8 == "f8") {
        Push(Dtype{});
        return absl::OkStatus();
      }
      return Fail(absl::StrCat("the matrix has type '", std::string(type ? type->utf8 : "?"),
                               "', expected 'f8'"));
    }
    return Fail("REDUCE with unexpected arguments");
  }

  absl::Status Build() {
    RS_ASSIGN_OR_RETURN(Ref argument, Pop());
    if (stack_.empty()) return Fail("BUILD on an empty stack");
    const Tuple* tuple = As<Tuple>(argument);
    if (tuple == nullptr) return Fail("BUILD with something that is not a tuple");
    const std::vector<Ref>& state = tuple->items;
    if (Dtype* dtype = As<Dtype>(stack_.back())) {
      const Text* order = state.size() >= 2 ? As<Text>(state[1]) : nullptr;
      if (order == nullptr || order->utf8 != "<") return Fail("the matrix is not little-endian");
      dtype->little_endian = true;
      return absl::OkStatus();
    }
    Array* array = As<Array>(stack_.back());
    if (array == nullptr || state.size() != 5)
      return Fail("BUILD of something that is not a matrix");
    const Tuple* shape = As<Tuple>(state[1]);
    const Dtype* dtype = As<Dtype>(state[2]);
    const bool* fortran = As<bool>(state[3]);
    Bytes* bytes = As<Bytes>(state[4]);
    if (!shape || !dtype || !dtype->little_endian || !fortran || !bytes)
      return Fail("the state of the matrix is malformed");
    if (*fortran) return Fail("the matrix is stored by columns, expected by rows");
    const int64_t* rows = shape->items.size() == 2 ? As<int64_t>(shape->items[0]) : nullptr;
    const int64_t* columns = shape->items.size() == 2 ? As<int64_t>(shape->items[1]) : nullptr;
    if (!rows || !columns || *rows < 1 || *columns < 1 || *rows > kMaxValues / *columns) {
      return Fail("the shape is not [rows, columns] of a sensible size");
    }
    const size_t expected = static_cast<size_t>(*rows * *columns) * sizeof(double);
    if (bytes->data.size() != expected) {
      return Fail(absl::StrCat("shape [", *rows, ", ", *columns, "] needs ", expected,
                               " bytes, got ", bytes->data.size()));
    }
    array->rows = *rows;
    array->columns = *columns;
    array->data = bytes->data;
    array->built = true;
    return absl::OkStatus();
  }

  const std::string& file_;
  std::string_view bytes_;
  size_t pos_ = 0, at_ = 0;
  size_t encoded_ = 0;  // bytes of text that REDUCE has encoded
  std::vector<Ref> stack_;
  std::map<int, Ref> memo_;
};

// What follows `key` in the header of a .npy file, a Python dictionary such as
// {'descr': '<f8', 'fortran_order': False, 'shape': (50, 79), }.
std::string_view After(std::string_view header, std::string_view key) {
  const size_t at = header.find(key);
  return at == std::string_view::npos ? "" : header.substr(at + key.size());
}

// NumPy's format, versions 1 to 3 (numpy/lib/format.py).
absl::StatusOr<Array> ParseNpy(const std::string& file, std::string_view bytes) {
  constexpr std::string_view kMagic = "\x93NUMPY";
  constexpr size_t kStart = 12;
  if (bytes.size() < kStart || !bytes.starts_with(kMagic)) return Bad(file, "no .npy in the zip");
  const auto byte = [&](size_t i) { return static_cast<size_t>(static_cast<uint8_t>(bytes[i])); };
  const size_t version = byte(6), begin = version == 1 ? 10 : 12;
  size_t length = byte(8) | byte(9) << 8;
  if (version > 1) length |= byte(10) << 16 | byte(11) << 24;
  if (version < 1 || version > 3 || bytes.size() - begin < length)
    return Bad(file, "the .npy header is cut off or of an unknown version");
  const std::string_view header = bytes.substr(begin, length);
  if (!After(header, "'descr': ").starts_with("'<f8'"))
    return Bad(file, "the .npy is not of little-endian float64 ('<f8')");
  if (!After(header, "'fortran_order': ").starts_with("False"))
    return Bad(file, "the .npy is empty or stored by columns, expected [rows, columns] by rows");
  const std::string_view shape = After(header, "'shape': (");
  const std::string_view inside = shape.substr(0, shape.find(')'));
  const std::vector<std::string> sizes =
      absl::StrSplit(std::string(inside), ", ", absl::SkipEmpty());
  Array array;
  if (sizes.size() != 2 || !absl::SimpleAtoi(sizes[0], &array.rows) ||
      !absl::SimpleAtoi(sizes[1], &array.columns) || array.rows < 1 || array.columns < 1 ||
      array.rows > kMaxValues / array.columns) {
    return Bad(file, absl::StrCat("shape (", std::string(inside),
                                  ") is not [rows, columns] of a sensible size"));
  }
  const size_t expected = static_cast<size_t>(array.rows * array.columns) * sizeof(double);
  if (bytes.size() - begin - length != expected) {
    return Bad(file, absl::StrCat("shape (", std::string(inside), ") needs ", expected,
                                  " bytes, got ", bytes.size() - begin - length));
  }
  array.data = std::string(bytes.substr(begin + length));
  return array;
}

absl::StatusOr<Array> ParseMatrix(const std::string& file, std::string_view bytes) {
  const absl::StatusOr<std::string> pickle = ReadZipEntry(bytes, "/data.pkl", kMaxBytes);
  if (pickle.ok()) return Unpickler(file, *pickle).Run();
  if (!absl::IsNotFound(pickle.status())) return Bad(file, std::string(pickle.status().message()));
  const absl::StatusOr<std::string> npy = ReadZipEntry(bytes, "states.npy", kMaxBytes);
  if (npy.ok()) return ParseNpy(file, *npy);
  if (!absl::IsNotFound(npy.status())) return Bad(file, std::string(npy.status().message()));
  return Bad(file, "no entry ends in '/data.pkl' or 'states.npy'");
}

}  // namespace

absl::StatusOr<InitStates> ParseInitStates(const std::string& file, std::string_view bytes) {
  if (bytes.size() > kMaxBytes)
    return Bad(file, absl::StrCat(bytes.size(), " bytes, at most ", kMaxBytes, " make sense"));
  RS_ASSIGN_OR_RETURN(const Array array, ParseMatrix(file, bytes));
  InitStates states;
  states.file = file;
  states.rows = static_cast<int>(array.rows);
  states.columns = static_cast<int>(array.columns);
  states.values.resize(static_cast<size_t>(array.rows * array.columns));
  std::memcpy(states.values.data(), array.data.data(), array.data.size());
  for (size_t i = 0; i < states.values.size(); ++i) {
    if (!(std::abs(states.values[i]) <= kMostValue)) {
      return Bad(file, absl::StrCat("row ", i / states.columns, ", column ", i % states.columns,
                                    " is ", states.values[i], ", must be -", kMostValue, " to ",
                                    kMostValue, " (s, m, rad and their rates)"));
    }
  }
  return states;
}

absl::StatusOr<InitStates> ReadInitStates(const std::string& file) {
  RS_ASSIGN_OR_RETURN(std::string bytes, ReadFile(file));
  return ParseInitStates(file, bytes);
}

absl::Status CheckEpisodeRows(const InitStates& states, int first, int episodes) {
  const int64_t end = int64_t{first} + episodes;
  if (end <= states.rows) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("episodes start from states ", first, " to ", end - 1, ", and ", states.file,
                   " has states 0 to ", states.rows - 1, "; ",
                   first < states.rows ? "give fewer episodes, " : "",
                   "begin with an earlier one or leave the task out"));
}

absl::Status CheckInitStates(const InitStates& states, int nq, int nv) {
  if (states.columns == 1 + nq + nv) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(states.file, ": rows have ", states.columns,
                   " values, the composed model needs 1 + nq + nv = 1 + ", nq, " + ", nv, " = ",
                   1 + nq + nv, "; the init file and the BDDL file do not belong together"));
}

absl::Status CheckFreeBodies(const InitStates& states, const std::vector<FreeBody>& bodies) {
  for (int row = 0; row < states.rows; ++row) {
    for (const FreeBody& body : bodies) {
      const int column = 1 + body.qpos;
      const double* pose = states.row(row) + column;
      const auto fail = [&](const char* what, int first, int last, const std::string& fault) {
        return Bad(states.file,
                   absl::StrCat("row ", row, ": the ", what, " of '", body.name, "', columns ",
                                column + first, " to ", column + last, ", ", fault));
      };
      const double distance = std::hypot(pose[0], pose[1], pose[2]);
      if (!(distance <= kMostDistance)) {
        return fail("position", 0, 2,
                    absl::StrCat("is ", distance, " m from the origin, at most ", kMostDistance,
                                 " make sense"));
      }
      const double norm = std::hypot(std::hypot(pose[3], pose[4]), std::hypot(pose[5], pose[6]));
      if (!(std::abs(norm - 1) <= kNormTolerance))
        return fail("quaternion", 3, 6, absl::StrCat("has norm ", norm, ", must be 1"));
    }
  }
  return absl::OkStatus();
}

absl::Status CheckLimitedJoints(const InitStates& states, const std::vector<LimitedJoint>& joints) {
  for (int row = 0; row < states.rows; ++row) {
    for (const LimitedJoint& joint : joints) {
      const int column = 1 + joint.qpos;
      const double value = states.row(row)[column];
      if (value >= joint.low - kBeyondLimit && value <= joint.high + kBeyondLimit) continue;
      return Bad(states.file,
                 absl::StrCat("row ", row, ": joint '", joint.name, "', column ", column, ", is ",
                              value, ", its limits are ", joint.low, " and ", joint.high));
    }
  }
  return absl::OkStatus();
}

}  // namespace robostress::libero
