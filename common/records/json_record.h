#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>

#include "absl/status/statusor.h"
#include "nlohmann/json.hpp"

namespace robostress {

// A record is one line of JSON whose struct is its own schema:
//   template <class Self, class V> static void Visit(Self& r, V& v) { v.Field("steps", r.steps);
//   ... }
// in the order in which its keys are written. Fields are bool, integers, double and std::string.
//   Field    must be there, and of its type
//   Measure  std::optional; null where there is no value, and a number that is not finite has none
//   Extra    std::optional; left out where there is no value
class RecordWriter {
 public:
  template <class T>
  void Field(const char* key, const T& value) {
    json_[key] = value;
  }
  template <class T>
  void Measure(const char* key, const std::optional<T>& value) {
    json_[key] = Has(value) ? nlohmann::ordered_json(*value) : nlohmann::ordered_json(nullptr);
  }
  template <class T>
  void Extra(const char* key, const std::optional<T>& value) {
    if (Has(value)) json_[key] = *value;
  }
  nlohmann::ordered_json Take() { return std::move(json_); }

 private:
  template <class T>
  static bool Has(const std::optional<T>& value) {
    if constexpr (std::is_floating_point_v<T>) return value && std::isfinite(*value);
    return value.has_value();
  }
  nlohmann::ordered_json json_ = nlohmann::ordered_json::object();
};

// Reads fields and remembers the first that is wrong: `source`, key, value and what it must be.
class RecordReader {
 public:
  // Both outlive the reader; `record` is an object.
  RecordReader(const std::string& source, const nlohmann::json& record)
      : source_(source), record_(record) {}

  template <class T>
  void Field(const char* key, T& value) {
    const auto field = record_.find(key);
    if (field == record_.end() || !Fits<T>(*field)) return Fail(key, Expected<T>());
    value = field->get<T>();
  }
  template <class T>
  void Measure(const char* key, std::optional<T>& value) {
    const auto field = record_.find(key);
    value.reset();
    if (field == record_.end() || field->is_null()) return;
    if (!Fits<T>(*field)) return Fail(key, Expected<T>());
    value = field->get<T>();
  }
  template <class T>
  void Extra(const char* key, std::optional<T>& value) {
    Measure(key, value);
  }
  const absl::Status& status() const { return status_; }

 private:
  template <class T>
  static bool Fits(const nlohmann::json& field) {
    if constexpr (std::is_same_v<T, bool>) {
      return field.is_boolean();
    } else if constexpr (std::is_same_v<T, std::string>) {
      return field.is_string();
    } else if constexpr (std::is_floating_point_v<T>) {
      return field.is_number();
    } else {
      if (field.is_number_unsigned()) return std::in_range<T>(field.get<uint64_t>());
      return field.is_number_integer() && std::in_range<T>(field.get<int64_t>());
    }
  }
  template <class T>
  static const char* Expected() {
    if constexpr (std::is_same_v<T, bool>) return "true or false";
    if constexpr (std::is_same_v<T, std::string>) return "text";
    return std::is_floating_point_v<T> ? "a number" : "an integer";
  }
  void Fail(const char* key, const char* expected);

  const std::string& source_;
  const nlohmann::json& record_;
  absl::Status status_;
};

template <class Record>
nlohmann::ordered_json RecordJson(const Record& record) {
  RecordWriter writer;
  Record::Visit(record, writer);
  return writer.Take();
}

template <class Record>
absl::Status ReadRecord(const std::string& source, const nlohmann::json& fields, Record& record) {
  RecordReader reader(source, fields);
  Record::Visit(record, reader);
  return reader.status();
}

// The object that a line of a file holds; `source` names file and line in the error (DATA_LOSS).
absl::StatusOr<nlohmann::json> ParseRecordLine(const std::string& source, const std::string& line);

}  // namespace robostress
