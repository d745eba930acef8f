#include "common/lerobot/thrift_reader.h"

#include <bit>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr int kDeepest = 16;
constexpr int kMostValues = 1'000'000;

enum WireType {
  kTrue = 1,
  kFalse,
  kByte,
  kInt16,
  kInt32,
  kInt64,
  kDouble,
  kBinary,
  kListOf,
  kSet,
  kMap,
  kStructOf
};

class Reader {
 public:
  explicit Reader(std::string_view bytes) : bytes_(bytes) {}
  size_t at() const { return at_; }

  absl::StatusOr<ThriftValue> Struct(int depth) {
    RS_RETURN_IF_ERROR(Count(depth));
    ThriftValue value;
    value.kind = ThriftValue::kStruct;
    int64_t field = 0;
    while (true) {
      RS_ASSIGN_OR_RETURN(const uint8_t head, Byte());
      if (head == 0) return value;
      if (head >> 4 != 0) {
        field += head >> 4;
      } else {
        RS_ASSIGN_OR_RETURN(field, Signed());
      }
      if (field < 1 || field > 1000)
        return absl::InvalidArgumentError(absl::StrCat("field ", field, " at byte ", at_));
      RS_ASSIGN_OR_RETURN(ThriftValue member, Value(head & 15, depth + 1, false));
      value.numbers.push_back(static_cast<int>(field));
      value.list.push_back(std::move(member));
    }
  }

 private:
  absl::Status Count(int depth) {
    if (depth > kDeepest) return absl::InvalidArgumentError("nests too deeply");
    if (++values_ > kMostValues) return absl::InvalidArgumentError("holds too many values");
    return absl::OkStatus();
  }

  absl::StatusOr<uint8_t> Byte() {
    if (at_ >= bytes_.size())
      return absl::InvalidArgumentError(absl::StrCat("ends too early, at byte ", at_));
    return static_cast<uint8_t>(bytes_[at_++]);
  }
  absl::StatusOr<uint64_t> Varint() {
    uint64_t value = 0;
    for (int shift = 0; shift < 64; shift += 7) {
      RS_ASSIGN_OR_RETURN(const uint8_t byte, Byte());
      value |= static_cast<uint64_t>(byte & 127) << shift;
      if (byte < 128) return value;
    }
    return absl::InvalidArgumentError(absl::StrCat("a number of too many bytes before ", at_));
  }
  absl::StatusOr<int64_t> Signed() {
    RS_ASSIGN_OR_RETURN(const uint64_t value, Varint());
    return static_cast<int64_t>(value >> 1) ^ -static_cast<int64_t>(value & 1);
  }
  absl::StatusOr<std::string_view> Take(uint64_t count) {
    if (count > bytes_.size() - at_)
      return absl::InvalidArgumentError(
          absl::StrCat(count, " bytes at byte ", at_, ", ", bytes_.size() - at_, " are there"));
    const std::string_view taken = bytes_.substr(at_, count);
    at_ += count;
    return taken;
  }

  // In a list a bool is a byte; as a field its type says what it is.
  absl::StatusOr<ThriftValue> Value(int type, int depth, bool in_list) {
    ThriftValue value;
    switch (type) {
      case kTrue:
      case kFalse:
        value.integer = type == kTrue;
        if (in_list) {
          RS_ASSIGN_OR_RETURN(const uint8_t byte, Byte());
          value.integer = byte == 1;
        }
        break;
      case kByte: {
        RS_ASSIGN_OR_RETURN(const uint8_t byte, Byte());
        value.integer =
            static_cast<int8_t>(byte);  // NOLINT(bugprone-signed-char-misuse): it has a sign
        break;
      }
      case kInt16:
      case kInt32:
      case kInt64: {
        RS_ASSIGN_OR_RETURN(value.integer, Signed());
        break;
      }
      case kDouble: {
        RS_ASSIGN_OR_RETURN(const std::string_view raw, Take(8));
        value.kind = ThriftValue::kReal;
        static_assert(std::endian::native == std::endian::little);
        std::memcpy(&value.real, raw.data(), 8);
        break;
      }
      case kBinary: {
        RS_ASSIGN_OR_RETURN(const uint64_t size, Varint());
        RS_ASSIGN_OR_RETURN(const std::string_view raw, Take(size));
        value.kind = ThriftValue::kText;
        value.text = std::string(raw);
        break;
      }
      case kListOf:
      case kSet:
        return List(depth);
      case kStructOf:
        return Struct(depth);
      default:
        return absl::InvalidArgumentError(absl::StrCat("type ", type, " before byte ", at_));
    }
    RS_RETURN_IF_ERROR(Count(depth));
    return value;
  }

  absl::StatusOr<ThriftValue> List(int depth) {
    RS_RETURN_IF_ERROR(Count(depth));
    ThriftValue value;
    value.kind = ThriftValue::kList;
    RS_ASSIGN_OR_RETURN(const uint8_t head, Byte());
    uint64_t size = head >> 4;
    if (size == 15) {
      RS_ASSIGN_OR_RETURN(size, Varint());
    }
    for (uint64_t i = 0; i < size; ++i) {  // every value takes a byte, so the bytes bound them
      RS_ASSIGN_OR_RETURN(ThriftValue element, Value(head & 15, depth + 1, true));
      value.list.push_back(std::move(element));
    }
    return value;
  }

  const std::string_view bytes_;
  size_t at_ = 0;
  int values_ = 0;
};

}  // namespace

const ThriftValue* ThriftValue::Find(int field, Kind wanted) const {
  for (size_t i = 0; i < numbers.size(); ++i) {
    if (numbers[i] == field) return list[i].kind == wanted ? &list[i] : nullptr;
  }
  return nullptr;
}

int64_t ThriftValue::Integer(int field, int64_t otherwise) const {
  const ThriftValue* value = Find(field, kInteger);
  return value == nullptr ? otherwise : value->integer;
}

absl::StatusOr<std::pair<ThriftValue, size_t>> ReadThriftStruct(std::string_view bytes) {
  Reader reader(bytes);
  RS_ASSIGN_OR_RETURN(ThriftValue value, reader.Struct(0));
  return std::pair(std::move(value), reader.at());
}

}  // namespace robostress
