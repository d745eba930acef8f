#include "common/lerobot/parquet_reader.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

// Values of parquet.thrift.
constexpr int64_t kInt32 = 1, kInt64 = 2, kFloat = 4, kDouble = 5;
constexpr int64_t kOptional = 1, kRepeated = 2;
constexpr int64_t kPlain = 0, kRle = 3;
constexpr int64_t kDataPage = 0;
constexpr const char* kCodecs[] = {"none", "snappy", "gzip", "lzo", "brotli", "lz4", "zstd"};

uint32_t Uint32At(std::string_view bytes) {
  uint32_t value;
  std::memcpy(&value, bytes.data(), 4);
  return value;
}

int BitsFor(int level) {
  int bits = 0;
  while (level >> bits != 0) ++bits;
  return bits;
}

// Of a node of the schema, which is written in depth-first order.
int64_t Children(const ThriftValue& node) {
  return std::clamp<int64_t>(node.Integer(5, 0), 0, 1'000'000);
}

// Levels in runs and packed groups (Parquet's "RLE / bit-packing hybrid"), `count` of them, behind
// their length in four bytes, which are taken off `page`. False: they end too early or are wrong.
bool TakeLevels(std::string_view* page, int most, size_t count, std::vector<uint8_t>* levels) {
  if (page->size() < 4 || Uint32At(*page) > page->size() - 4) return false;
  std::string_view runs = page->substr(4, Uint32At(*page));
  page->remove_prefix(4 + runs.size());
  const int bits = BitsFor(most);
  levels->clear();
  while (levels->size() < count) {
    uint64_t head = 0;
    int shift = 0;
    do {
      if (runs.empty() || shift > 28) return false;
      head |= static_cast<uint64_t>(runs.front() & 127) << shift;
      shift += 7;
      if ((runs.front() & 128) == 0) break;
      runs.remove_prefix(1);
    } while (true);
    runs.remove_prefix(1);
    const size_t left = count - levels->size();
    if ((head & 1) == 0) {
      if (runs.empty()) return false;
      const auto level = static_cast<uint8_t>(runs.front());
      runs.remove_prefix(1);
      levels->insert(levels->end(), std::min<size_t>(head >> 1, left), level);
      if (head >> 1 == 0) return false;
    } else {
      const size_t packed = (head >> 1) * static_cast<size_t>(bits);
      if (packed > runs.size() || head >> 1 == 0) return false;
      for (size_t i = 0; i < std::min<size_t>(8 * (head >> 1), left); ++i) {
        uint8_t level = 0;
        for (int b = 0; b < bits; ++b) {
          const size_t bit = i * static_cast<size_t>(bits) + static_cast<size_t>(b);
          level |= static_cast<uint8_t>((runs[bit / 8] >> (bit % 8) & 1) << b);
        }
        levels->push_back(level);
      }
      runs.remove_prefix(packed);
    }
  }
  return std::all_of(levels->begin(), levels->end(), [&](uint8_t level) { return level <= most; });
}

template <class T>
void AppendNumbers(std::string_view values, std::vector<double>* numbers) {
  for (size_t i = 0; i + sizeof(T) <= values.size(); i += sizeof(T)) {
    T value;
    std::memcpy(&value, values.data() + i, sizeof(T));
    numbers->push_back(static_cast<double>(value));
  }
}

}  // namespace

absl::Status ParquetReader::Wrong(const std::string& what) const {
  return absl::InvalidArgumentError(
      absl::StrCat(name_, ": ", what, "; read are Parquet files as robot_client writes them"));
}

absl::StatusOr<ParquetReader> ParquetReader::Parse(std::string name, std::string bytes) {
  ParquetReader reader(std::move(name), std::move(bytes));
  const std::string_view all = reader.bytes_;
  if (all.size() < 12 || all.substr(0, 4) != "PAR1" || all.substr(all.size() - 4) != "PAR1")
    return reader.Wrong(absl::StrCat("is no whole Parquet file (", all.size(), " bytes)"));
  const size_t size = Uint32At(all.substr(all.size() - 8));
  if (size > all.size() - 12)
    return reader.Wrong(absl::StrCat("its footer of ", size, " bytes is larger than the file"));
  auto footer = ReadThriftStruct(all.substr(all.size() - 8 - size, size));
  if (!footer.ok()) return reader.Wrong(absl::StrCat("footer: ", footer.status().message()));
  reader.footer_ = std::move(footer->first);
  reader.rows_ = reader.footer_.Integer(3, -1);
  if (reader.rows_ < 0 || reader.rows_ > (int64_t{1} << 40))
    return reader.Wrong(absl::StrCat("num_rows is ", reader.rows_));
  return reader;
}

absl::StatusOr<ParquetReader::Levels> ParquetReader::LevelsOf(
    const std::vector<std::string>& path) const {
  const ThriftValue* schema = footer_.Find(2, ThriftValue::kList);
  if (schema == nullptr || schema->list.empty()) return Wrong("has no schema");
  Levels levels;
  size_t at = 1;
  int64_t siblings = Children(schema->list[0]);
  for (size_t depth = 0; depth < path.size(); ++depth) {
    bool found = false;
    for (int64_t i = 0; i < siblings && at < schema->list.size() && !found; ++i) {
      const ThriftValue& node = schema->list[at];
      const ThriftValue* name = node.Find(4, ThriftValue::kText);
      if (name != nullptr && name->text == path[depth]) {
        const int64_t repetition = node.Integer(3, 0);
        levels.definition += repetition == kOptional || repetition == kRepeated;
        levels.repetition += repetition == kRepeated;
        siblings = Children(node);
        ++at;
        found = true;
        break;
      }
      for (int64_t below = 1; below > 0 && at < schema->list.size(); ++at)
        below += Children(schema->list[at]) - 1;
    }
    if (!found) return Wrong(absl::StrCat("has no column ", absl::StrJoin(path, ".")));
  }
  if (siblings != 0) return Wrong(absl::StrCat(absl::StrJoin(path, "."), " is no column"));
  return levels;
}

absl::StatusOr<std::vector<double>> ParquetReader::Numbers(const std::string& column,
                                                           int list) const {
  std::vector<double> numbers;
  const auto wanted = static_cast<size_t>(rows_) * static_cast<size_t>(std::max(list, 1));
  // A value takes four bytes at least, so the file bounds what is believed of their number.
  if (wanted > bytes_.size() / 4)
    return Wrong(
        absl::StrCat(column, ": ", rows_, " rows do not fit in ", bytes_.size(), " bytes"));
  const ThriftValue* groups = footer_.Find(4, ThriftValue::kList);
  if (groups == nullptr) return Wrong("has no row groups");
  for (const ThriftValue& group : groups->list) {
    const ThriftValue* columns = group.Find(1, ThriftValue::kList);
    const ThriftValue* found = nullptr;
    std::vector<std::string> path;
    for (size_t i = 0; columns != nullptr && i < columns->list.size() && found == nullptr; ++i) {
      const ThriftValue* chunk = columns->list[i].Find(3, ThriftValue::kStruct);
      const ThriftValue* names = chunk == nullptr ? nullptr : chunk->Find(3, ThriftValue::kList);
      path.clear();
      for (size_t k = 0; names != nullptr && k < names->list.size(); ++k)
        path.push_back(names->list[k].text);
      if (!path.empty() && path[0] == column && path.size() == (list > 0 ? 3u : 1u)) found = chunk;
    }
    if (found == nullptr)
      return Wrong(absl::StrCat("has no column ", column, list > 0 ? " of lists" : ""));
    RS_ASSIGN_OR_RETURN(const Levels levels, LevelsOf(path));
    if (levels.repetition != (list > 0 ? 1 : 0) || levels.definition > 3)
      return Wrong(absl::StrCat(column, " nests otherwise than a list of numbers"));
    RS_RETURN_IF_ERROR(ReadChunk(*found, levels, list, wanted, &numbers));
  }
  if (numbers.size() != wanted)
    return Wrong(absl::StrCat(column, " holds ", numbers.size(), " numbers for ", rows_, " rows"));
  return numbers;
}

absl::Status ParquetReader::ReadChunk(const ThriftValue& chunk, Levels levels, int list,
                                      size_t most, std::vector<double>* numbers) const {
  const int64_t codec = chunk.Integer(4, 0);
  if (codec != 0)
    return Wrong(absl::StrCat("is compressed (",
                              codec > 0 && codec < 7 ? kCodecs[codec] : absl::StrCat(codec), ")"));
  if (chunk.Find(11, ThriftValue::kInteger) != nullptr) return Wrong("holds a dictionary");
  const int64_t type = chunk.Integer(1, -1);
  if (type != kInt32 && type != kInt64 && type != kFloat && type != kDouble)
    return Wrong(absl::StrCat("values are of type ", type, ", numbers are wanted"));
  const int64_t values = chunk.Integer(5, -1), offset = chunk.Integer(9, -1);
  if (values < 0 || values > static_cast<int64_t>(most - numbers->size()) || offset < 4 ||
      offset > static_cast<int64_t>(bytes_.size()))
    return Wrong(absl::StrCat("a column of ", values, " values at byte ", offset));
  std::string_view rest = std::string_view(bytes_).substr(static_cast<size_t>(offset));
  const size_t until = numbers->size() + static_cast<size_t>(values);
  while (numbers->size() < until) {
    const auto header = ReadThriftStruct(rest);
    if (!header.ok()) return Wrong(absl::StrCat("page: ", header.status().message()));
    rest.remove_prefix(header->second);
    const int64_t size = header->first.Integer(3, -1);
    if (size <= 0 || size > static_cast<int64_t>(rest.size()))
      return Wrong(absl::StrCat("a page of ", size, " bytes, ", rest.size(), " are left"));
    RS_RETURN_IF_ERROR(ReadPage(rest.substr(0, static_cast<size_t>(size)), header->first, type,
                                levels, list, until, numbers));
    rest.remove_prefix(static_cast<size_t>(size));
  }
  return absl::OkStatus();
}

absl::Status ParquetReader::ReadPage(std::string_view page, const ThriftValue& header, int64_t type,
                                     Levels levels, int list, size_t most,
                                     std::vector<double>* numbers) const {
  const ThriftValue* data = header.Find(5, ThriftValue::kStruct);
  if (header.Integer(1, -1) != kDataPage || data == nullptr)
    return Wrong("a page is no data page of version 1");
  const int64_t count = data->Integer(1, -1);
  if (data->Integer(2, -1) != kPlain || data->Integer(3, kRle) != kRle ||
      data->Integer(4, kRle) != kRle)
    return Wrong(
        absl::StrCat("values are encoded otherwise than plain (", data->Integer(2, -1), ")"));
  if (count <= 0 || count > static_cast<int64_t>(most - numbers->size()))
    return Wrong(absl::StrCat("a page of ", count, " values"));
  std::vector<uint8_t> repetition, definition;
  if (levels.repetition > 0) {
    if (!TakeLevels(&page, levels.repetition, static_cast<size_t>(count), &repetition))
      return Wrong("a page's repetition levels are damaged");
    for (size_t i = 0; i < repetition.size(); ++i) {
      if ((repetition[i] == 0) != (i % static_cast<size_t>(list) == 0))
        return Wrong(absl::StrCat("a list has not ", list, " numbers"));
    }
  }
  if (levels.definition > 0) {
    if (!TakeLevels(&page, levels.definition, static_cast<size_t>(count), &definition))
      return Wrong("a page's definition levels are damaged");
    if (std::any_of(definition.begin(), definition.end(),
                    [&](uint8_t level) { return level != levels.definition; }))
      return Wrong("values are missing");
  }
  const size_t width = type == kInt32 || type == kFloat ? 4 : 8;
  if (page.size() != static_cast<size_t>(count) * width)
    return Wrong(absl::StrCat("a page holds ", page.size(), " bytes for ", count, " values"));
  if (type == kInt32) AppendNumbers<int32_t>(page, numbers);
  if (type == kInt64) AppendNumbers<int64_t>(page, numbers);
  if (type == kFloat) AppendNumbers<float>(page, numbers);
  if (type == kDouble) AppendNumbers<double>(page, numbers);
  return absl::OkStatus();
}

}  // namespace robostress
