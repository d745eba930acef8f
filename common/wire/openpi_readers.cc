#include "common/wire/openpi_readers.h"

#include <cmath>
#include <cstring>
#include <string_view>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/rollout/field_checks.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

template <class T>
void Append(std::string_view data, std::vector<double>& numbers) {
  for (size_t at = 0; at < data.size(); at += sizeof(T)) {
    T value;
    std::memcpy(&value, data.data() + at, sizeof(T));
    numbers.push_back(static_cast<double>(value));
  }
}

void AppendNumbers(const OpenpiArray& array, std::vector<double>& numbers) {
  numbers.reserve(array.data.size() / array.item_size());
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

size_t OpenpiCount(const OpenpiValue& value) {
  if (const auto* array = std::get_if<OpenpiArray>(&value.value))
    return array->data.size() / array->item_size();
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
  RS_RETURN_IF_ERROR(CheckUtf8(field, *text));
  return std::string(*text);
}

}  // namespace robostress
