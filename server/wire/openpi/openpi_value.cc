#include "server/wire/openpi/openpi_value.h"

#define MSGPACK_NO_BOOST  // the C++ standard library has what it would take from there
#include <cmath>
#include <cstring>
#include <limits>
#include <msgpack.hpp>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

// A sink of msgpack::packer.
struct Appender {
  std::string& bytes;
  void write(const char* data, size_t size) { bytes.append(data, size); }
};

msgpack::packer<Appender> Packer(Appender& appender) { return msgpack::packer<Appender>(appender); }

// Bytes of one element; 0: a kind that is not taken.
size_t ItemSize(std::string_view dtype) {
  if (dtype.size() != 3) return 0;
  const char order = dtype[0], kind = dtype[1];
  const auto size = static_cast<size_t>(dtype[2] - '0');
  if (order != '<' && order != '|') return 0;
  if (size > 1 && order != '<') return 0;
  switch (kind) {
    case 'b':
      return size == 1 ? 1 : 0;
    case 'u':
    case 'i':
      return size == 1 || size == 2 || size == 4 || size == 8 ? size : 0;
    case 'f':
      return size == 4 || size == 8 ? size : 0;
    default:
      return 0;
  }
}

std::string Shown(std::string_view text) {
  return absl::CHexEscape(std::string(text.substr(0, 64)));
}

// What the parser calls back: builds the tree, counts, and refuses. A stack of open maps and lists
// stands for the recursion.
class Builder : public msgpack::null_visitor {
 public:
  absl::Status status;
  OpenpiValue root;

  bool visit_nil() { return Put({}); }
  bool visit_boolean(bool v) { return Put({v}); }
  bool visit_positive_integer(uint64_t v) {
    if (v > static_cast<uint64_t>(std::numeric_limits<int64_t>::max()))
      return Refuse(absl::StrCat("is ", v, ", an integer beyond 63 bits"));
    return Put({static_cast<int64_t>(v)});
  }
  bool visit_negative_integer(int64_t v) { return Put({v}); }
  bool visit_float32(float v) { return Put({static_cast<double>(v)}); }
  bool visit_float64(double v) { return Put({v}); }
  bool visit_str(const char* data, uint32_t size) { return Text({data, size}); }
  bool visit_bin(const char* data, uint32_t size) { return Text({data, size}); }
  bool visit_ext(const char*, uint32_t) {
    return Refuse("is a msgpack extension, which is not taken");
  }
  bool start_map(uint32_t) { return Open(OpenpiValue::Map()); }
  bool start_array(uint32_t) { return Open(OpenpiValue::List()); }
  bool start_map_key() {
    open_.back().wants_key = true;
    return true;
  }
  bool end_map_key() {
    if (!open_.back().wants_key) return true;
    return Refuse("has a key that is neither text nor bytes");
  }
  bool end_array() {
    open_.pop_back();
    return true;
  }
  bool end_map() {
    OpenpiValue* map = open_.back().value;
    open_.pop_back();
    if (absl::Status made = NumpyOf(*map); !made.ok()) return Refuse(std::string(made.message()));
    return true;
  }
  void parse_error(size_t, size_t at) { Broken(absl::StrCat("no msgpack at byte ", at)); }
  void insufficient_bytes(size_t, size_t at) {
    Broken(absl::StrCat("ends at byte ", at, ", within a value"));
  }

 private:
  struct Level {
    OpenpiValue* value;  // a map or a list; stays where it is while it is open
    bool wants_key = false;
    std::string key;
  };

  void Broken(const std::string& what) {
    if (status.ok()) status = absl::InvalidArgumentError(absl::StrCat("message: ", what));
  }
  std::string Path() const {
    std::vector<std::string> keys;
    for (const Level& level : open_) keys.push_back(Shown(level.key));
    return keys.empty() ? "message" : absl::StrJoin(keys, "/");
  }
  bool Refuse(const std::string& what) {
    if (status.ok()) status = absl::InvalidArgumentError(absl::StrCat(Path(), " ", what));
    return false;
  }
  // Where the next value goes; null where it must not.
  OpenpiValue* Place() {
    if (++count_ > OpenpiLimits::kValues) {
      Refuse(absl::StrCat("is one value too many; a message may hold ", OpenpiLimits::kValues));
      return nullptr;
    }
    if (open_.empty()) return &root;
    Level& top = open_.back();
    if (top.wants_key) {
      Refuse("has a key that is neither text nor bytes");
      return nullptr;
    }
    if (auto* list = std::get_if<OpenpiValue::List>(&top.value->value))
      return &list->emplace_back();
    return &std::get<OpenpiValue::Map>(top.value->value)[top.key];
  }
  bool Put(OpenpiValue value) {
    OpenpiValue* place = Place();
    if (place == nullptr) return false;
    *place = std::move(value);
    return true;
  }
  bool Text(std::string_view text) {
    if (open_.empty() || !open_.back().wants_key) return Put({text});
    Level& top = open_.back();
    top.key = text;
    top.wants_key = false;
    if (text.size() > 256) return Refuse("is a key longer than 256 bytes");
    if (std::get<OpenpiValue::Map>(top.value->value).count(top.key) != 0)
      return Refuse("occurs twice in one map");
    return ++count_ <= OpenpiLimits::kValues ||
           Refuse(
               absl::StrCat("is one value too many; a message may hold ", OpenpiLimits::kValues));
  }
  template <class Container>
  bool Open(Container container) {
    if (open_.size() >= OpenpiLimits::kDepth)
      return Refuse(absl::StrCat("is nested deeper than ", OpenpiLimits::kDepth));
    OpenpiValue* place = Place();
    if (place == nullptr) return false;
    place->value = std::move(container);
    open_.push_back({place});
    return true;
  }

  // Replaces a map that describes a NumPy array or scalar by what it describes.
  static absl::Status NumpyOf(OpenpiValue& value) {
    const auto is_true = [&value](std::string_view key) {
      const OpenpiValue* found = value.Find(key);
      const bool* flag = found == nullptr ? nullptr : std::get_if<bool>(&found->value);
      return flag != nullptr && *flag;
    };
    if (is_true("__npgeneric__")) {
      const OpenpiValue* data = value.Find("data");
      if (data == nullptr || data->value.index() > 4)
        return absl::InvalidArgumentError("is a NumPy scalar without plain data");
      OpenpiValue plain = *data;
      value = std::move(plain);
      return absl::OkStatus();
    }
    if (!is_true("__ndarray__")) return absl::OkStatus();
    const OpenpiValue *dtype = value.Find("dtype"), *shape = value.Find("shape"),
                      *data = value.Find("data");
    OpenpiArray array;
    const auto* name = dtype == nullptr ? nullptr : std::get_if<std::string_view>(&dtype->value);
    if (name == nullptr) return absl::InvalidArgumentError("is an array without a dtype");
    array.dtype = *name;
    const size_t item = ItemSize(array.dtype);
    if (item == 0) {
      return absl::InvalidArgumentError(
          absl::StrCat("has dtype '", Shown(array.dtype),
                       "'; taken are bool, integers, float32 and float64, little-endian"));
    }
    const auto* sizes = shape == nullptr ? nullptr : std::get_if<OpenpiValue::List>(&shape->value);
    if (sizes == nullptr || sizes->size() > OpenpiLimits::kDimensions)
      return absl::InvalidArgumentError("is an array without a shape of at most 8 numbers");
    uint64_t bytes = item;
    constexpr uint64_t kMost = uint64_t{1} << 32;
    for (const OpenpiValue& size : *sizes) {
      const int64_t* n = std::get_if<int64_t>(&size.value);
      if (n == nullptr || *n < 0 || static_cast<uint64_t>(*n) > kMost)
        return absl::InvalidArgumentError("has a shape with an impossible entry");
      array.shape.push_back(*n);
      bytes *= static_cast<uint64_t>(*n);
      if (bytes > kMost) return absl::InvalidArgumentError("has a shape of more than 4 GiB");
    }
    const auto* content = data == nullptr ? nullptr : std::get_if<std::string_view>(&data->value);
    if (content == nullptr || content->size() != bytes) {
      return absl::InvalidArgumentError(absl::StrCat(
          "holds ", content == nullptr ? 0 : content->size(), " bytes; dtype ", array.dtype,
          " and shape [", absl::StrJoin(array.shape, ", "), "] need ", bytes));
    }
    array.data = *content;
    value.value = std::move(array);
    return absl::OkStatus();
  }

  std::vector<Level> open_;
  size_t count_ = 0;
};

template <class T>
void Append(std::string_view data, std::vector<double>& numbers) {
  for (size_t at = 0; at < data.size(); at += sizeof(T)) {
    T value;
    std::memcpy(&value, data.data() + at, sizeof(T));
    numbers.push_back(static_cast<double>(value));
  }
}

void AppendNumbers(const OpenpiArray& array, std::vector<double>& numbers) {
  numbers.reserve(array.data.size() / static_cast<size_t>(array.dtype[2] - '0'));
  const std::string_view kind = std::string_view(array.dtype).substr(1);
  if (kind == "f4") return Append<float>(array.data, numbers);
  if (kind == "f8") return Append<double>(array.data, numbers);
  if (kind == "i1") return Append<int8_t>(array.data, numbers);
  if (kind == "i2") return Append<int16_t>(array.data, numbers);
  if (kind == "i4") return Append<int32_t>(array.data, numbers);
  if (kind == "i8") return Append<int64_t>(array.data, numbers);
  if (kind == "u2") return Append<uint16_t>(array.data, numbers);
  if (kind == "u4") return Append<uint32_t>(array.data, numbers);
  if (kind == "u8") return Append<uint64_t>(array.data, numbers);
  Append<uint8_t>(array.data, numbers);  // u1, b1
}

bool AppendNumber(const OpenpiValue& value, std::vector<double>& numbers) {
  if (const auto* v = std::get_if<double>(&value.value)) {
    numbers.push_back(*v);
  } else if (const auto* i = std::get_if<int64_t>(&value.value)) {
    numbers.push_back(static_cast<double>(*i));
  } else if (const auto* b = std::get_if<bool>(&value.value)) {
    numbers.push_back(*b ? 1 : 0);
  } else {
    return false;
  }
  return true;
}

}  // namespace

const OpenpiValue* OpenpiValue::Find(std::string_view key) const {
  const Map* map = this->map();
  if (map == nullptr) return nullptr;
  const auto found = map->find(key);
  return found == map->end() ? nullptr : &found->second;
}

absl::StatusOr<OpenpiValue> DecodeOpenpi(std::string_view message) {
  Builder builder;
  size_t at = 0;
  bool whole = false;
  try {
    whole = msgpack::parse(message.data(), message.size(), at, builder);
  } catch (const std::exception& error) {  // msgpack's, and out of memory
    return absl::InvalidArgumentError(absl::StrCat("message: ", error.what()));
  }
  RS_RETURN_IF_ERROR(builder.status);
  if (!whole) return absl::InvalidArgumentError("message: is no msgpack value");
  if (at != message.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat("message: ", message.size() - at, " bytes follow the map"));
  }
  if (builder.root.map() == nullptr) return absl::InvalidArgumentError("message: is no map");
  return std::move(builder.root);
}

size_t OpenpiCount(const OpenpiValue& value) {
  if (const auto* array = std::get_if<OpenpiArray>(&value.value))
    return array->data.size() / ItemSize(array->dtype);
  const auto* list = std::get_if<OpenpiValue::List>(&value.value);
  return list == nullptr ? 1 : list->size();
}

absl::StatusOr<std::vector<double>> OpenpiNumbers(const std::string& field,
                                                  const OpenpiValue& value, size_t most) {
  if (const size_t count = OpenpiCount(value); count > most) {
    return absl::InvalidArgumentError(
        absl::StrCat(field, ": holds ", count, " numbers, must hold at most ", most));
  }
  std::vector<double> numbers;
  if (const auto* array = std::get_if<OpenpiArray>(&value.value)) {
    AppendNumbers(*array, numbers);
  } else if (const auto* list = std::get_if<OpenpiValue::List>(&value.value)) {
    for (size_t i = 0; i < list->size(); ++i) {
      if (!AppendNumber((*list)[i], numbers))
        return absl::InvalidArgumentError(absl::StrCat(field, "[", i, "]: is no number"));
    }
  } else if (!AppendNumber(value, numbers)) {
    return absl::InvalidArgumentError(absl::StrCat(field, ": is neither an array nor a number"));
  }
  for (size_t i = 0; i < numbers.size(); ++i) {
    if (!std::isfinite(numbers[i])) {
      return absl::InvalidArgumentError(
          absl::StrCat(field, "[", i, "] is ", numbers[i], ", must be finite"));
    }
  }
  return numbers;
}

absl::StatusOr<Eigen::MatrixXd> OpenpiMatrix(const std::string& field, const OpenpiValue& value,
                                             OpenpiSide rows, OpenpiSide cols) {
  const auto* array = std::get_if<OpenpiArray>(&value.value);
  const auto shown = [](const OpenpiSide& side) {
    return side.least == side.most ? absl::StrCat(side.least)
                                   : absl::StrCat(side.least, "..", side.most);
  };
  const auto fits = [](int64_t size, const OpenpiSide& side) {
    return size >= side.least && size <= side.most;
  };
  if (array == nullptr || array->shape.size() != 2 || !fits(array->shape[0], rows) ||
      !fits(array->shape[1], cols)) {
    return absl::InvalidArgumentError(absl::StrCat(
        field, ": ",
        array == nullptr ? "is no array"
                         : absl::StrCat("has shape [", absl::StrJoin(array->shape, ", "), "]"),
        ", must be an array of shape [", shown(rows), ", ", shown(cols), "]"));
  }
  RS_ASSIGN_OR_RETURN(
      const std::vector<double> numbers,
      OpenpiNumbers(field, value, static_cast<size_t>(array->shape[0] * array->shape[1])));
  Eigen::MatrixXd matrix(array->shape[0], array->shape[1]);
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    for (Eigen::Index j = 0; j < matrix.cols(); ++j)
      matrix(i, j) = numbers[static_cast<size_t>(i * matrix.cols() + j)];
  }
  return matrix;
}

absl::StatusOr<int64_t> OpenpiInteger(const std::string& field, const OpenpiValue& value,
                                      int64_t low, int64_t high) {
  const int64_t* number = std::get_if<int64_t>(&value.value);
  if (number == nullptr || *number < low || *number > high) {
    return absl::InvalidArgumentError(absl::StrCat(
        field, ": ", number == nullptr ? "is no integer" : absl::StrCat("is ", *number),
        ", must be ", low, "..", high));
  }
  return *number;
}

absl::StatusOr<std::string> OpenpiText(const std::string& field, const OpenpiValue& value,
                                       size_t most) {
  const auto* text = std::get_if<std::string_view>(&value.value);
  if (text == nullptr || text->size() > most) {
    return absl::InvalidArgumentError(absl::StrCat(
        field, ": ", text == nullptr ? "is no text" : absl::StrCat("has ", text->size(), " bytes"),
        ", must be a text of at most ", most, " bytes"));
  }
  return std::string(*text);
}

OpenpiWriter& OpenpiWriter::Map(uint32_t pairs) {
  Appender to{bytes_};
  Packer(to).pack_map(pairs);
  return *this;
}
OpenpiWriter& OpenpiWriter::List(uint32_t items) {
  Appender to{bytes_};
  Packer(to).pack_array(items);
  return *this;
}
OpenpiWriter& OpenpiWriter::Text(std::string_view text) {
  Appender to{bytes_};
  const auto size = static_cast<uint32_t>(text.size());
  Packer(to).pack_str(size).pack_str_body(text.data(), size);
  return *this;
}
OpenpiWriter& OpenpiWriter::Integer(int64_t value) {
  Appender to{bytes_};
  Packer(to).pack_int64(value);
  return *this;
}
OpenpiWriter& OpenpiWriter::Real(double value) {
  Appender to{bytes_};
  Packer(to).pack_double(value);
  return *this;
}
OpenpiWriter& OpenpiWriter::Boolean(bool value) {
  Appender to{bytes_};
  value ? Packer(to).pack_true() : Packer(to).pack_false();
  return *this;
}

OpenpiWriter& OpenpiWriter::Array(const Eigen::MatrixXf& matrix) {
  Appender to{bytes_};
  const auto bin = [&to](std::string_view text) {
    const auto size = static_cast<uint32_t>(text.size());
    Packer(to).pack_bin(size).pack_bin_body(text.data(), size);
  };
  const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows = matrix;
  Packer(to).pack_map(4);
  bin("__ndarray__");
  Packer(to).pack_true();
  bin("data");
  bin({reinterpret_cast<const char*>(rows.data()),
       static_cast<size_t>(rows.size()) * sizeof(float)});
  bin("dtype");
  Text("<f4");
  bin("shape");
  List(2).Integer(matrix.rows()).Integer(matrix.cols());
  return *this;
}

}  // namespace robostress
