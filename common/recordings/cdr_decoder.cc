#include "common/recordings/cdr_decoder.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

using Kind = RosField::Kind;

constexpr int64_t kMostValues = 1'000'000;
constexpr int kDeepest = 33;
constexpr size_t kPadding = 8;  // behind the last field, at most this less one

size_t SizeOf(Kind kind) {
  switch (kind) {
    case Kind::kInt16:
    case Kind::kUint16:
      return 2;
    case Kind::kInt32:
    case Kind::kUint32:
    case Kind::kFloat32:
    case Kind::kString:
      return 4;
    case Kind::kInt64:
    case Kind::kUint64:
    case Kind::kFloat64:
      return 8;
    default:
      return 1;
  }
}

class Decoder {
 public:
  Decoder(const RosSchema& schema, absl::string_view bytes, bool swapped, size_t most_alignment)
      : schema_(schema), bytes_(bytes), swapped_(swapped), most_alignment_(most_alignment) {}

  absl::StatusOr<CdrValue> Struct(size_t type, int depth) {
    if (depth > kDeepest) return absl::InvalidArgumentError("nests too deeply");
    CdrValue value;
    for (const RosField& field : schema_.types()[type].fields) {
      RS_RETURN_IF_ERROR(CountOne(field));
      RS_ASSIGN_OR_RETURN(CdrValue member, Field(field, depth));
      value.items.push_back(std::move(member));
    }
    return value;
  }
  size_t left() const { return bytes_.size() - at_; }

 private:
  absl::Status Wrong(const RosField& field, absl::string_view what) const {
    return absl::InvalidArgumentError(absl::StrCat("field ", field.name, " ", what));
  }
  absl::Status CountOne(const RosField& field) {
    if (++values_ <= kMostValues) return absl::OkStatus();
    return Wrong(field, absl::StrCat("is value ", values_, ", at most ", kMostValues));
  }

  absl::StatusOr<CdrValue> Field(const RosField& field, int depth) {
    int64_t count = 1;
    if (field.array && field.fixed >= 0) count = field.fixed;
    if (field.array && field.fixed < 0) {
      RS_ASSIGN_OR_RETURN(const uint32_t stated, Number<uint32_t>(field));
      if (field.most >= 0 && stated > field.most)
        return Wrong(field, absl::StrCat("has ", stated, " entries, its type allows ", field.most));
      count = stated;
    }
    // Every entry takes a byte or more, so the bytes bound what is believed of their number.
    if (static_cast<uint64_t>(count) > left() / SizeOf(field.kind))
      return Wrong(field, absl::StrCat("has ", count, " entries, ", left(), " bytes are left"));
    if (field.kind == Kind::kStruct && !field.array) return Struct(field.type, depth + 1);
    CdrValue value;
    for (int64_t i = 0; i < count; ++i) {
      RS_RETURN_IF_ERROR(CountOne(field));
      if (field.kind == Kind::kStruct) {
        RS_ASSIGN_OR_RETURN(CdrValue item, Struct(field.type, depth + 1));
        value.items.push_back(std::move(item));
      } else if (field.kind == Kind::kString) {
        RS_ASSIGN_OR_RETURN(std::string text, Text(field));
        value.texts.push_back(std::move(text));
      } else {
        RS_ASSIGN_OR_RETURN(const double number, Primitive(field));
        value.numbers.push_back(number);
      }
    }
    return value;
  }

  absl::StatusOr<std::string> Text(const RosField& field) {
    RS_ASSIGN_OR_RETURN(const uint32_t size, Number<uint32_t>(field));
    if (size > left())
      return Wrong(field, absl::StrCat("is a text of ", size, " bytes, ", left(), " are left"));
    std::string text(bytes_.substr(at_, size));
    at_ += size;
    if (!text.empty() && text.back() != '\0')
      return Wrong(field, "is a text without the NUL at its end");
    if (!text.empty()) text.pop_back();
    if (field.longest >= 0 && static_cast<int64_t>(text.size()) > field.longest)
      return Wrong(field, absl::StrCat("is a text of ", text.size(), " bytes, its type allows ",
                                       field.longest));
    return text;
  }

  absl::StatusOr<double> Primitive(const RosField& field) {
    switch (field.kind) {
      case Kind::kInt8:
        return As<int8_t>(field);
      case Kind::kInt16:
        return As<int16_t>(field);
      case Kind::kUint16:
        return As<uint16_t>(field);
      case Kind::kInt32:
        return As<int32_t>(field);
      case Kind::kUint32:
        return As<uint32_t>(field);
      case Kind::kInt64:
        return As<int64_t>(field);
      case Kind::kUint64:
        return As<uint64_t>(field);
      case Kind::kFloat32:
        return As<float>(field);
      case Kind::kFloat64:
        return As<double>(field);
      case Kind::kWideString:
        return Wrong(field, "is a wstring, whose width writers disagree on; it is not read");
      default:
        return As<uint8_t>(field);
    }
  }
  template <class T>
  absl::StatusOr<double> As(const RosField& field) {
    RS_ASSIGN_OR_RETURN(const T value, Number<T>(field));
    return static_cast<double>(value);
  }
  template <class T>
  absl::StatusOr<T> Number(const RosField& field) {
    const size_t alignment = std::min(sizeof(T), most_alignment_);
    const size_t begin = (at_ + alignment - 1) / alignment * alignment;
    if (begin > bytes_.size() || bytes_.size() - begin < sizeof(T))
      return Wrong(field, absl::StrCat("ends behind the message's ", bytes_.size(), " bytes"));
    char raw[sizeof(T)];
    std::memcpy(raw, bytes_.data() + begin, sizeof(T));
    if (swapped_) std::reverse(raw, raw + sizeof(T));
    at_ = begin + sizeof(T);
    T value;
    std::memcpy(&value, raw, sizeof(T));
    return value;
  }

  const RosSchema& schema_;
  const absl::string_view bytes_;
  const bool swapped_;
  const size_t most_alignment_;
  size_t at_ = 0;
  int64_t values_ = 0;
};

}  // namespace

absl::StatusOr<CdrValue> DecodeCdr(const RosSchema& schema, absl::string_view message) {
  static_assert(std::endian::native == std::endian::little);
  if (message.size() < 4)
    return absl::InvalidArgumentError(
        absl::StrCat("encapsulation: the message has ", message.size(), " bytes, 4 are needed"));
  const int kind = static_cast<uint8_t>(message[0]) << 8 | static_cast<uint8_t>(message[1]);
  // CDR_BE, CDR_LE, CDR2_BE, CDR2_LE; others have members in any order, or lengths between them.
  if (kind != 0 && kind != 1 && kind != 6 && kind != 7)
    return absl::InvalidArgumentError(
        absl::StrCat("encapsulation: its kind is ", kind, "; read are plain CDR (0, 1, 6, 7)"));
  Decoder decoder(schema, message.substr(4), kind % 2 == 0, kind >= 6 ? 4 : 8);
  RS_ASSIGN_OR_RETURN(CdrValue value, decoder.Struct(0, 0));
  if (decoder.left() >= kPadding)
    return absl::InvalidArgumentError(absl::StrCat(
        decoder.left(), " bytes are left behind the last field; the schema is another message's"));
  return value;
}

}  // namespace robostress
