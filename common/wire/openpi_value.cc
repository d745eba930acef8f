#include "common/wire/openpi_value.h"

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

}  // namespace

const OpenpiValue* OpenpiValue::Find(std::string_view key) const {
  const Map* map = this->map();
  if (map == nullptr) return nullptr;
  const auto found = map->find(key);
  return found == map->end() ? nullptr : &found->second;
}

absl::StatusOr<OpenpiValue> DecodeOpenpiValue(std::string_view message) {
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
  return std::move(builder.root);
}

absl::StatusOr<OpenpiValue> DecodeOpenpi(std::string_view message) {
  RS_ASSIGN_OR_RETURN(OpenpiValue value, DecodeOpenpiValue(message));
  if (value.map() == nullptr) return absl::InvalidArgumentError("message: is no map");
  return value;
}

}  // namespace robostress
