#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "common/random.h"
#include "tests/common/wire/openpi_bytes.h"

namespace robostress {

// A message of openpi's wire as a tree that may hold what no server should say: keys twice or of
// another kind, integers of 64 bits, arrays whose bytes and shape disagree. It shares no code with
// the readers.
struct Wild {
  struct Array {
    std::string dtype;
    std::vector<int64_t> shape;
    std::string data;
  };
  struct Bin {
    std::string bytes;
  };
  struct Extension {};
  using List = std::vector<Wild>;
  using Map = std::vector<std::pair<Wild, Wild>>;
  std::variant<std::monostate, bool, int64_t, uint64_t, float, double, std::string, Bin, Extension,
               Array, List, Map>
      value;

  template <class T>
  static Wild Of(T value) {
    Wild wild;
    wild.value = std::move(value);
    return wild;
  }
  static Wild Text(std::string text) { return Of(std::move(text)); }
  static Wild Whole(int64_t value) { return Of(value); }
  static Wild Pairs(const std::vector<std::pair<std::string, Wild>>& pairs) {
    Map map;
    for (const auto& [key, item] : pairs) map.emplace_back(Text(key), item);
    return Of(std::move(map));
  }
  template <class T>
  static Wild Numbers(const std::string& dtype, std::vector<int64_t> shape,
                      const std::vector<T>& values) {
    return Of(Array{dtype,
                    std::move(shape),
                    {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)}});
  }

  // The first of that key, text or bytes; null: no map, or not in it.
  const Wild* Find(const std::string& key) const {
    const auto* map = std::get_if<Map>(&value);
    if (map == nullptr) return nullptr;
    for (const auto& [name, item] : *map) {
      const auto* text = std::get_if<std::string>(&name.value);
      const auto* bin = std::get_if<Bin>(&name.value);
      if ((text != nullptr && *text == key) || (bin != nullptr && bin->bytes == key)) return &item;
    }
    return nullptr;
  }

  // An array as the map that it is on the wire.
  static Wild Opened(const Array& array) {
    List shape;
    for (const int64_t size : array.shape) shape.push_back(Whole(size));
    Map map;
    map.emplace_back(Of(Bin{"__ndarray__"}), Of(true));
    map.emplace_back(Of(Bin{"data"}), Of(Bin{array.data}));
    map.emplace_back(Of(Bin{"dtype"}), Text(array.dtype));
    map.emplace_back(Of(Bin{"shape"}), Of(std::move(shape)));
    return Of(std::move(map));
  }

  std::string Bytes() const {
    OpenpiBytes bytes;
    Write(bytes);
    return bytes.bytes();
  }

 private:
  static void Real(OpenpiBytes& bytes, double value) {
    bytes.Byte(0xcb).Big(std::bit_cast<uint64_t>(value), 8);
  }
  static void Long(OpenpiBytes& bytes, int kind, const std::string& text) {
    bytes.Byte(kind).Big(text.size(), 4);
    for (const char c : text) bytes.Byte(static_cast<unsigned char>(c));
  }
  void Write(OpenpiBytes& bytes) const {
    struct Visitor {
      OpenpiBytes& out;
      void operator()(std::monostate) const { out.Byte(0xc0); }
      void operator()(bool v) const { out.Byte(v ? 0xc3 : 0xc2); }
      void operator()(int64_t v) const { out.Byte(0xd3).Big(static_cast<uint64_t>(v), 8); }
      void operator()(uint64_t v) const { out.Byte(0xcf).Big(v, 8); }
      void operator()(float v) const { out.Byte(0xca).Big(std::bit_cast<uint32_t>(v), 4); }
      void operator()(double v) const { Real(out, v); }
      void operator()(const std::string& v) const { Long(out, 0xdb, v); }
      void operator()(const Bin& v) const { Long(out, 0xc6, v.bytes); }
      void operator()(const Extension&) const { out.Byte(0xd6).Byte(5).Big(7, 4); }
      void operator()(const Array& v) const { Opened(v).Write(out); }
      void operator()(const List& v) const {
        out.Byte(0xdd).Big(v.size(), 4);
        for (const Wild& item : v) item.Write(out);
      }
      void operator()(const Map& v) const {
        out.Byte(0xdf).Big(v.size(), 4);
        for (const auto& [key, item] : v) {
          key.Write(out);
          item.Write(out);
        }
      }
    };
    std::visit(Visitor{bytes}, value);
  }
};

// Changes one place of a tree, whatever it holds there.
class WildMutator {
 public:
  explicit WildMutator(RandomStream& random) : random_(random) {}

  void Change(Wild& root) {
    std::vector<Wild*> places;
    Collect(root, places);
    Wild& at = *places[static_cast<size_t>(Up(static_cast<int>(places.size())))];
    if (auto* array = std::get_if<Wild::Array>(&at.value); array != nullptr && Up(5) > 0)
      return Up(4) == 0 ? static_cast<void>(at = Wild::Opened(Wild::Array(*array)))
                        : ChangeArray(*array);
    if (auto* map = std::get_if<Wild::Map>(&at.value); map != nullptr && !map->empty() && Up(3) > 0)
      return ChangeMap(*map);
    if (auto* list = std::get_if<Wild::List>(&at.value);
        list != nullptr && !list->empty() && Up(3) > 0) {
      Up(2) == 0 ? list->pop_back() : list->push_back(Strange());
      return;
    }
    at = Strange();
  }

 private:
  int Up(int limit) { return random_.UniformInt(limit); }  // 0..limit - 1
  template <class T>
  T Pick(const std::vector<T>& values) {
    return values[static_cast<size_t>(Up(static_cast<int>(values.size())))];
  }
  double StrangeNumber() {
    constexpr double kInf = std::numeric_limits<double>::infinity();
    return Pick<double>(
        {0, -0.0, 1, 7, 8, 0.5, -1, 1e39, -1e308, 5e-324, kInf, -kInf, std::nan("")});
  }
  int64_t StrangeWhole() {
    return Pick<int64_t>({0, -1, 1, 2, 4, 5, 6, 7, 8, 14, 1024, 1025, 4097, 1 << 31,
                          int64_t{1} << 32, int64_t{1} << 62, INT64_MAX, INT64_MIN});
  }
  Wild Strange() {
    switch (Up(12)) {
      case 0:
        return Wild();
      case 1:
        return Wild::Of(Up(2) == 0);
      case 2:
      case 3:
        return Wild::Whole(StrangeWhole());
      case 4:
        return Wild::Of(UINT64_MAX - static_cast<uint64_t>(Up(2)));
      case 5:
        return Wild::Of(StrangeNumber());
      case 6:
        return Wild::Of(static_cast<float>(StrangeNumber()));
      case 7:
        return Wild::Text(Pick<std::string>({"", "7", "error", "actions", "\xff\xfe", "agentview",
                                             std::string(5000, 'x'), std::string("a\0b", 3)}));
      case 8:
        return Wild::Of(Wild::Bin{std::string(static_cast<size_t>(Up(40)), '\x7f')});
      case 9:
        return Wild::Of(Wild::Extension());
      case 10: {
        Wild nested = Wild::Whole(1);
        for (int depth = Up(20); depth >= 0; --depth)
          nested = Up(2) == 0 ? Wild::Pairs({{"actions", nested}}) : Wild::Of(Wild::List{nested});
        return nested;
      }
      default:
        return Wild::Of(
            Wild::List(static_cast<size_t>(Pick<int>({0, 1, 7, 70, 25000})), Wild::Whole(Up(3))));
    }
  }
  void ChangeMap(Wild::Map& map) {
    auto& [key, item] = map[static_cast<size_t>(Up(static_cast<int>(map.size())))];
    switch (Up(6)) {
      case 0:
        map.erase(map.begin() + Up(static_cast<int>(map.size())));
        break;
      case 1:
        map.emplace_back(Wild(key), Strange());  // twice
        break;
      case 2:
        map.emplace_back(Wild::Text("more"), Wild(item));
        break;
      case 3:
        key = Strange();
        break;
      case 4:
        item = Wild::Pairs({{"actions", Wild(item)}});
        break;
      default:
        item = Strange();
    }
  }
  void ChangeArray(Wild::Array& array) {
    const size_t size = array.data.size();
    switch (Up(8)) {
      case 0:
        array.dtype = Pick<std::string>(
            {"<f4", "<f8", "<f2", ">f4", "<i8", "<i4", "|b1", "|u1", "|O", "<U3", "<c8", "", "f4"});
        break;
      case 1:
        if (!array.shape.empty()) array.shape.back() = StrangeWhole();
        break;
      case 2:
        array.shape.insert(array.shape.begin(), Up(2) == 0 ? 1 : StrangeWhole());
        break;
      case 3:
        array.shape.clear();
        break;
      case 4:
        array.data.resize(static_cast<size_t>(Up(static_cast<int>(size) + 9)));
        break;
      case 5: {  // other rows or columns, and the bytes for them
        const int64_t rows = Pick<int64_t>({0, 1, 4, 5, 9, 11, 1024, 1025}),
                      cols = Pick<int64_t>({7, 7, 6, 8, 0});
        array = {"<f4", {rows, cols}, std::string(static_cast<size_t>(rows * cols * 4), '\0')};
        break;
      }
      default:  // one number
        if (array.dtype == "<f8" && size >= 8) {
          const double value = StrangeNumber();
          std::memcpy(array.data.data() + 8 * Up(static_cast<int>(size / 8)), &value, 8);
        } else if (array.dtype == "<f4" && size >= 4) {
          const auto value = static_cast<float>(StrangeNumber());
          std::memcpy(array.data.data() + 4 * Up(static_cast<int>(size / 4)), &value, 4);
        }
    }
  }
  static void Collect(Wild& at, std::vector<Wild*>& places) {
    places.push_back(&at);
    if (auto* list = std::get_if<Wild::List>(&at.value))
      for (Wild& item : *list) Collect(item, places);
    if (auto* map = std::get_if<Wild::Map>(&at.value))
      for (auto& [key, item] : *map) Collect(item, places);
  }

  RandomStream& random_;
};

}  // namespace robostress
