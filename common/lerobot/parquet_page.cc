#include "common/lerobot/parquet_page.h"

#include <snappy.h>
#include <zstd.h>

#include <algorithm>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

// Values of parquet.thrift.
constexpr int64_t kInt32 = 1, kInt64 = 2, kFloat = 4;
constexpr int64_t kPlain = 0, kPlainDictionary = 2, kRle = 3, kRleDictionary = 8;
constexpr int64_t kDataPage = 0, kDictionaryPage = 2, kDataPageV2 = 3;
constexpr int64_t kNone = 0, kSnappy = 1, kZstd = 6;
constexpr const char* kCodecs[] = {"none", "snappy", "gzip", "lzo", "brotli", "lz4", "zstd"};

absl::Status Wrong(absl::string_view what) { return absl::InvalidArgumentError(std::string(what)); }

uint32_t Uint32At(absl::string_view bytes) {
  uint32_t value;
  std::memcpy(&value, bytes.data(), 4);
  return value;
}

int BitsFor(int level) {
  int bits = 0;
  while (level >> bits != 0) ++bits;
  return bits;
}

// Numbers of `bits` in runs and packed groups (Parquet's "RLE / bit-packing hybrid"), `count` of
// them. False: they end too early or are wrong.
bool ReadHybrid(absl::string_view runs, int bits, size_t count, std::vector<uint32_t>* values) {
  const auto bytes = static_cast<size_t>((bits + 7) / 8);
  values->clear();
  while (values->size() < count) {
    uint64_t head = 0;
    for (int shift = 0;; shift += 7) {
      if (runs.empty() || shift > 28) return false;
      const auto byte = static_cast<uint8_t>(runs.front());
      runs.remove_prefix(1);
      head |= static_cast<uint64_t>(byte & 127) << shift;
      if (byte < 128) break;
    }
    const size_t left = count - values->size();
    if (head >> 1 == 0) return false;
    if ((head & 1) == 0) {
      if (runs.size() < bytes) return false;
      uint32_t value = 0;
      std::memcpy(&value, runs.data(), bytes);
      runs.remove_prefix(bytes);
      values->insert(values->end(), std::min<size_t>(head >> 1, left), value);
      continue;
    }
    const size_t packed = (head >> 1) * static_cast<size_t>(bits);
    if (packed > runs.size()) return false;
    for (size_t i = 0; i < std::min<size_t>(8 * (head >> 1), left); ++i) {
      uint32_t value = 0;
      for (int b = 0; b < bits; ++b) {
        const size_t bit = i * static_cast<size_t>(bits) + static_cast<size_t>(b);
        value |= static_cast<uint32_t>(static_cast<uint8_t>(runs[bit / 8]) >> (bit % 8) & 1) << b;
      }
      values->push_back(value);
    }
    runs.remove_prefix(packed);
  }
  return true;
}

// Levels behind their length in four bytes, which are taken off `page`.
bool TakeLevels(absl::string_view* page, int most, size_t count, std::vector<uint32_t>* levels) {
  if (most == 0) return true;
  if (page->size() < 4 || Uint32At(*page) > page->size() - 4) return false;
  const absl::string_view runs = page->substr(4, Uint32At(*page));
  page->remove_prefix(4 + runs.size());
  return ReadHybrid(runs, BitsFor(most), count, levels);
}

absl::StatusOr<std::string> Inflate(int64_t codec, absl::string_view packed, int64_t size) {
  if (codec != kNone && codec != kSnappy && codec != kZstd)
    return Wrong(absl::StrCat("is compressed (",
                              codec > 0 && codec < 7 ? kCodecs[codec] : absl::StrCat(codec),
                              "); read are none, snappy and zstd"));
  if (size < 0 || size > ParquetPages::kMostPage)
    return Wrong(absl::StrCat("a page of ", size, " bytes, at most ", ParquetPages::kMostPage));
  const auto wanted = static_cast<size_t>(size);
  std::string bytes;
  if (codec == kNone) {
    bytes = std::string(packed);
  } else if (codec == kSnappy) {
    size_t stated = 0;
    if (!snappy::GetUncompressedLength(packed.data(), packed.size(), &stated) || stated != wanted ||
        stated > 64 * packed.size() + 64 ||
        !snappy::Uncompress(packed.data(), packed.size(), &bytes))
      return Wrong(absl::StrCat("a page is no snappy of ", size, " bytes"));
  } else {
    if (ZSTD_getFrameContentSize(packed.data(), packed.size()) != wanted)
      return Wrong(absl::StrCat("a page is no zstd of ", size, " bytes"));
    bytes.resize(wanted);
    const size_t made = ZSTD_decompress(bytes.data(), bytes.size(), packed.data(), packed.size());
    if (ZSTD_isError(made) || made != wanted)
      return Wrong(absl::StrCat("a page is no zstd of ", size, " bytes"));
  }
  if (bytes.size() != wanted)
    return Wrong(absl::StrCat("a page inflates to ", bytes.size(), " bytes, not ", size));
  return bytes;
}

template <class T>
void AppendPlain(absl::string_view values, std::vector<double>* numbers) {
  for (size_t i = 0; i + sizeof(T) <= values.size(); i += sizeof(T)) {
    T value;
    std::memcpy(&value, values.data() + i, sizeof(T));
    numbers->push_back(static_cast<double>(value));
  }
}

absl::Status ReadPlain(int64_t physical, int64_t count, absl::string_view values,
                       std::vector<double>* numbers) {
  const size_t width = physical == kInt32 || physical == kFloat ? 4 : 8;
  if (values.size() != static_cast<size_t>(count) * width)
    return Wrong(absl::StrCat("a page holds ", values.size(), " bytes for ", count, " values"));
  if (physical == kInt32) {
    AppendPlain<int32_t>(values, numbers);
  } else if (physical == kInt64) {
    AppendPlain<int64_t>(values, numbers);
  } else if (physical == kFloat) {
    AppendPlain<float>(values, numbers);
  } else {
    AppendPlain<double>(values, numbers);
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status ParquetPages::Take(const ThriftValue& header, absl::string_view body) {
  const int64_t kind = header.Integer(1, -1), size = header.Integer(2, -1);
  if (kind == kDictionaryPage) {
    const ThriftValue* page = header.Find(7, ThriftValue::kStruct);
    if (page == nullptr || has_dictionary_ || !numbers_.empty())
      return Wrong("a dictionary stands where none is allowed");
    RS_ASSIGN_OR_RETURN(const std::string values, Inflate(type_.codec, body, size));
    return TakeDictionary(*page, values);
  }
  if (kind == kDataPage) {
    const ThriftValue* page = header.Find(5, ThriftValue::kStruct);
    if (page == nullptr) return Wrong("a data page has no header");
    RS_ASSIGN_OR_RETURN(const std::string bytes, Inflate(type_.codec, body, size));
    return TakeFirstVersion(*page, bytes);
  }
  if (kind == kDataPageV2) {
    const ThriftValue* page = header.Find(8, ThriftValue::kStruct);
    if (page == nullptr) return Wrong("a data page has no header");
    return TakeSecondVersion(*page, body, size);
  }
  return Wrong(absl::StrCat("a page is of kind ", kind, ", neither data nor dictionary"));
}

absl::Status ParquetPages::TakeDictionary(const ThriftValue& page, absl::string_view values) {
  const int64_t count = page.Integer(1, -1), encoding = page.Integer(2, -1);
  if (encoding != kPlain && encoding != kPlainDictionary)
    return Wrong(absl::StrCat("a dictionary is encoded otherwise than plain (", encoding, ")"));
  if (count < 0 || count > static_cast<int64_t>(values.size()))
    return Wrong(absl::StrCat("a dictionary of ", count, " values"));
  has_dictionary_ = true;
  return ReadPlain(type_.physical, count, values, &dictionary_);
}

// Rows of lists may go on from one page to the next.
absl::Status ParquetPages::CheckLevels(const std::vector<uint32_t>& repetition,
                                       const std::vector<uint32_t>& definition) const {
  for (size_t i = 0; i < repetition.size(); ++i) {
    if ((repetition[i] == 0) != ((numbers_.size() + i) % static_cast<size_t>(type_.list) == 0))
      return Wrong(absl::StrCat("a list has not ", type_.list, " numbers"));
  }
  if (std::any_of(definition.begin(), definition.end(),
                  [&](uint32_t level) { return level != static_cast<uint32_t>(type_.definition); }))
    return Wrong("values are missing");
  return absl::OkStatus();
}

absl::Status ParquetPages::TakeFirstVersion(const ThriftValue& page, absl::string_view body) {
  const int64_t count = page.Integer(1, -1);
  if (count <= 0 || count > static_cast<int64_t>(most_ - numbers_.size()))
    return Wrong(absl::StrCat("a page of ", count, " values"));
  if (page.Integer(3, kRle) != kRle || page.Integer(4, kRle) != kRle)
    return Wrong("a page's levels are encoded otherwise than in runs");
  std::vector<uint32_t> repetition, definition;
  if (!TakeLevels(&body, type_.repetition, static_cast<size_t>(count), &repetition))
    return Wrong("a page's repetition levels are damaged");
  if (!TakeLevels(&body, type_.definition, static_cast<size_t>(count), &definition))
    return Wrong("a page's definition levels are damaged");
  RS_RETURN_IF_ERROR(CheckLevels(repetition, definition));
  return TakeValues(page.Integer(2, -1), count, body);
}

// Levels stand before the values, never compressed, and their lengths in the header.
absl::Status ParquetPages::TakeSecondVersion(const ThriftValue& page, absl::string_view body,
                                             int64_t size) {
  const int64_t count = page.Integer(1, -1);
  if (count <= 0 || count > static_cast<int64_t>(most_ - numbers_.size()))
    return Wrong(absl::StrCat("a page of ", count, " values"));
  const int64_t definitions = page.Integer(5, -1), repetitions = page.Integer(6, -1);
  const auto most = static_cast<int64_t>(body.size());
  if (definitions < 0 || definitions > most || repetitions < 0 || repetitions > most - definitions)
    return Wrong(absl::StrCat("levels of ", definitions, " and ", repetitions,
                              " bytes in a page of ", body.size()));
  std::vector<uint32_t> repetition, definition;
  const auto n = static_cast<size_t>(count);
  const auto first = static_cast<size_t>(repetitions), second = static_cast<size_t>(definitions);
  if (type_.repetition > 0 &&
      !ReadHybrid(body.substr(0, first), BitsFor(type_.repetition), n, &repetition))
    return Wrong("a page's repetition levels are damaged");
  if (type_.definition > 0 &&
      !ReadHybrid(body.substr(first, second), BitsFor(type_.definition), n, &definition))
    return Wrong("a page's definition levels are damaged");
  RS_RETURN_IF_ERROR(CheckLevels(repetition, definition));
  // A bool that is left out is true.
  const int64_t codec = page.Integer(7, 1) != 0 ? type_.codec : kNone;
  RS_ASSIGN_OR_RETURN(const std::string values, Inflate(codec, body.substr(first + second),
                                                        size - repetitions - definitions));
  return TakeValues(page.Integer(4, -1), count, values);
}

absl::Status ParquetPages::TakeValues(int64_t encoding, int64_t count, absl::string_view values) {
  if (encoding == kPlain) return ReadPlain(type_.physical, count, values, &numbers_);
  if (encoding != kPlainDictionary && encoding != kRleDictionary)
    return Wrong(absl::StrCat("values are encoded otherwise than plain or by a dictionary (",
                              encoding, ")"));
  if (!has_dictionary_) return Wrong("a page refers to a dictionary that is not there");
  std::vector<uint32_t> indices;
  const int bits = values.empty() ? -1 : static_cast<uint8_t>(values.front());
  if (bits < 0 || bits > 32 ||
      !ReadHybrid(values.substr(1), bits, static_cast<size_t>(count), &indices))
    return Wrong("a page's dictionary indices are damaged");
  for (const uint32_t index : indices) {
    if (index >= dictionary_.size())
      return Wrong(
          absl::StrCat("a value is number ", index, " of a dictionary of ", dictionary_.size()));
    numbers_.push_back(dictionary_[index]);
  }
  return absl::OkStatus();
}

}  // namespace robostress
