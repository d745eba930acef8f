#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress {

// A NumPy array as openpi puts it into msgpack: a map whose keys __ndarray__, data, dtype and shape
// are bin (openpi) or str (other clients).
struct OpenpiArray {
  std::string dtype;           // NumPy's: "|u1", "<f4", "<f8", "<i8", "|b1" ...
  std::vector<int64_t> shape;  // each at least 0
  std::string_view data;       // C order; exactly as long as dtype and shape say
};

// A message of openpi's wire, decoded. Texts and arrays are views into the message's bytes.
struct OpenpiValue {
  using List = std::vector<OpenpiValue>;
  using Map = std::map<std::string, OpenpiValue, std::less<>>;
  std::variant<std::monostate, bool, int64_t, double, std::string_view, OpenpiArray, List, Map>
      value;

  const OpenpiValue* Find(std::string_view key) const;  // null: no map, or not in it
  const Map* map() const { return std::get_if<Map>(&value); }
};

// What one message may hold at most.
struct OpenpiLimits {
  static constexpr int kDepth = 8;
  static constexpr size_t kValues = 20000;  // maps, lists, keys and scalars together
  static constexpr int kDimensions = 8;
};

// Decodes one message: a msgpack map and nothing after it. Trusts nothing; extension types and
// NumPy's structured, object and complex kinds are refused, so nothing is ever executed or
// converted on the client's word. INVALID_ARGUMENT names the key. Text and arrays are views of
// `message`, which outlives them.
absl::StatusOr<OpenpiValue> DecodeOpenpi(std::string_view message);
absl::StatusOr<OpenpiValue> DecodeOpenpi(std::string&& message) = delete;

// The readers below look at how much a value holds before they convert or copy any of it: what they
// allocate follows from what is expected, not from what came.

// How many numbers an array of any shape, a list or a scalar holds.
size_t OpenpiCount(const OpenpiValue& value);
// Those numbers, at most `most`. INVALID_ARGUMENT names `field`, and the entry that is not finite
// or no number.
absl::StatusOr<std::vector<double>> OpenpiNumbers(const std::string& field,
                                                  const OpenpiValue& value, size_t most);

// What a side of a matrix may measure.
struct OpenpiSide {
  OpenpiSide(int exactly) : least(exactly), most(exactly) {}  // NOLINT: a number is a side
  OpenpiSide(int least, int most) : least(least), most(most) {}
  int least, most;
};
// An array of two dimensions.
absl::StatusOr<Eigen::MatrixXd> OpenpiMatrix(const std::string& field, const OpenpiValue& value,
                                             OpenpiSide rows, OpenpiSide cols);
// Integer within [low, high].
absl::StatusOr<int64_t> OpenpiInteger(const std::string& field, const OpenpiValue& value,
                                      int64_t low, int64_t high);

// A text (or bytes) of at most `most` bytes.
absl::StatusOr<std::string> OpenpiText(const std::string& field, const OpenpiValue& value,
                                       size_t most);

// Writes one message. Map(n) is followed by n pairs of a key and a value.
class OpenpiWriter {
 public:
  OpenpiWriter& Map(uint32_t pairs);
  OpenpiWriter& List(uint32_t items);
  OpenpiWriter& Text(std::string_view text);  // keys too
  OpenpiWriter& Integer(int64_t value);
  OpenpiWriter& Real(double value);
  OpenpiWriter& Boolean(bool value);
  // As an array "<f4" of shape [rows, cols] with openpi's bin keys. openpi's chunk broker cuts
  // every array of a reply by step: only chunks may be arrays.
  OpenpiWriter& Array(const Eigen::MatrixXf& matrix);
  const std::string& bytes() const { return bytes_; }
  std::string Take() { return std::move(bytes_); }

 private:
  std::string bytes_;
};

}  // namespace robostress
