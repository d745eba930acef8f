#include "common/lerobot/parquet_reader.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
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
constexpr size_t kMostFooter = size_t{64} << 20;
constexpr int64_t kMostChunk = int64_t{1} << 30;  // of a column in a group of rows [bytes]
constexpr size_t kMostNumbers = size_t{1} << 25;  // of a column in a group of rows
constexpr size_t kMostInAll = size_t{1} << 27;    // of a column

uint32_t Uint32At(std::string_view bytes) {
  uint32_t value;
  std::memcpy(&value, bytes.data(), 4);
  return value;
}

// Of a node of the schema, which is written in depth-first order.
int64_t Children(const ThriftValue& node) {
  return std::clamp<int64_t>(node.Integer(5, 0), 0, 1'000'000);
}

}  // namespace

// A file in memory, or on the disk and read piece by piece.
class ParquetReader::Bytes {
 public:
  explicit Bytes(std::string bytes) : bytes_(std::move(bytes)), size_(bytes_.size()) {}
  Bytes(int file, size_t size) : file_(file), size_(size) {}
  ~Bytes() {
    if (file_ >= 0) close(file_);
  }
  Bytes(const Bytes&) = delete;
  Bytes& operator=(const Bytes&) = delete;
  size_t size() const { return size_; }
  // Shorter than `count` only where the file became shorter.
  std::string Read(size_t offset, size_t count) const {
    if (file_ < 0) return bytes_.substr(offset, count);
    std::string read(count, '\0');
    size_t at = 0;
    while (at < count) {
      const ssize_t some =
          pread(file_, read.data() + at, count - at, static_cast<off_t>(offset + at));
      if (some < 0 && errno == EINTR) continue;
      if (some <= 0) break;
      at += static_cast<size_t>(some);
    }
    read.resize(at);
    return read;
  }

 private:
  const std::string bytes_;
  const int file_ = -1;
  const size_t size_;
};

absl::Status ParquetReader::Wrong(const std::string& what) const {
  return absl::InvalidArgumentError(
      absl::StrCat(name_, ": ", what,
                   "; read are Parquet files of numbers as LeRobot and robot_client write them"));
}

absl::StatusOr<ParquetReader> ParquetReader::Parse(std::string name, std::string bytes) {
  return ReadFooter(std::move(name), std::make_shared<const Bytes>(std::move(bytes)));
}

absl::StatusOr<ParquetReader> ParquetReader::Open(const std::string& path) {
  const int file = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0)
    return absl::NotFoundError(absl::StrCat("'", path, "' cannot be read: ", std::strerror(errno)));
  const off_t size = lseek(file, 0, SEEK_END);
  return ReadFooter(
      path, std::make_shared<const Bytes>(file, static_cast<size_t>(std::max<off_t>(size, 0))));
}

absl::StatusOr<ParquetReader> ParquetReader::ReadFooter(std::string name,
                                                        std::shared_ptr<const Bytes> bytes) {
  ParquetReader reader(std::move(name), std::move(bytes));
  const size_t all = reader.bytes_->size();
  const std::string tail = all < 12 ? "" : reader.bytes_->Read(all - 8, 8);
  if (tail.size() != 8 || reader.bytes_->Read(0, 4) != "PAR1" || tail.substr(4) != "PAR1")
    return reader.Wrong(absl::StrCat("is no whole Parquet file (", all, " bytes)"));
  const size_t size = Uint32At(tail);
  if (size > all - 12 || size > kMostFooter)
    return reader.Wrong(absl::StrCat("its footer of ", size, " bytes is larger than the file"));
  auto footer = ReadThriftStruct(reader.bytes_->Read(all - 8 - size, size));
  if (!footer.ok()) return reader.Wrong(absl::StrCat("footer: ", footer.status().message()));
  reader.footer_ = std::move(footer->first);
  reader.rows_ = reader.footer_.Integer(3, -1);
  if (reader.rows_ < 0 || reader.rows_ > (int64_t{1} << 40))
    return reader.Wrong(absl::StrCat("num_rows is ", reader.rows_));
  return reader;
}

size_t ParquetReader::groups() const {
  const ThriftValue* groups = footer_.Find(4, ThriftValue::kList);
  return groups == nullptr ? 0 : groups->list.size();
}

absl::Status ParquetReader::FindLevels(const std::vector<std::string>& path,
                                       ParquetColumnType* type) const {
  const ThriftValue* schema = footer_.Find(2, ThriftValue::kList);
  if (schema == nullptr || schema->list.empty()) return Wrong("has no schema");
  size_t at = 1;
  int64_t siblings = Children(schema->list[0]);
  for (size_t depth = 0; depth < path.size(); ++depth) {
    bool found = false;
    for (int64_t i = 0; i < siblings && at < schema->list.size() && !found; ++i) {
      const ThriftValue& node = schema->list[at];
      const ThriftValue* name = node.Find(4, ThriftValue::kText);
      if (name != nullptr && name->text == path[depth]) {
        const int64_t repetition = node.Integer(3, 0);
        type->definition += repetition == kOptional || repetition == kRepeated;
        type->repetition += repetition == kRepeated;
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
  return absl::OkStatus();
}

absl::StatusOr<std::vector<double>> ParquetReader::Numbers(const std::string& column,
                                                           int list) const {
  if (groups() == 0 && rows_ > 0) return Wrong("has no row groups");
  const auto wanted = static_cast<size_t>(rows_) * static_cast<size_t>(std::max(list, 1));
  std::vector<double> numbers;
  for (size_t group = 0; group < groups(); ++group) {
    RS_ASSIGN_OR_RETURN(const std::vector<double> some, NumbersOfGroup(group, column, list));
    if (some.size() > std::min(wanted, kMostInAll) - numbers.size())
      return Wrong(absl::StrCat(column, " holds more numbers than ", rows_, " rows, or more than ",
                                kMostInAll));
    numbers.insert(numbers.end(), some.begin(), some.end());
  }
  if (numbers.size() != wanted)
    return Wrong(absl::StrCat(column, " holds ", numbers.size(), " numbers for ", rows_, " rows"));
  return numbers;
}

absl::StatusOr<std::vector<double>> ParquetReader::NumbersOfGroup(size_t index,
                                                                  const std::string& column,
                                                                  int list) const {
  const ThriftValue& group = footer_.Find(4, ThriftValue::kList)->list[index];
  const int64_t rows = group.Integer(3, -1);
  if (rows < 0 || rows > static_cast<int64_t>(kMostNumbers) / std::max(list, 1))
    return Wrong(absl::StrCat("a group of ", rows, " rows"));
  const ThriftValue* columns = group.Find(1, ThriftValue::kList);
  for (size_t i = 0; columns != nullptr && i < columns->list.size(); ++i) {
    const ThriftValue* chunk = columns->list[i].Find(3, ThriftValue::kStruct);
    const ThriftValue* names = chunk == nullptr ? nullptr : chunk->Find(3, ThriftValue::kList);
    std::vector<std::string> path;
    for (size_t k = 0; names != nullptr && k < names->list.size(); ++k)
      path.push_back(names->list[k].text);
    if (path.empty() || path[0] != column || path.size() != (list > 0 ? 3u : 1u)) continue;
    ParquetColumnType type;
    type.list = list;
    RS_RETURN_IF_ERROR(FindLevels(path, &type));
    if (type.repetition != (list > 0 ? 1 : 0) || type.definition > 3)
      return Wrong(absl::StrCat(column, " nests otherwise than a list of numbers"));
    auto numbers =
        ReadChunk(*chunk, type, static_cast<size_t>(rows) * static_cast<size_t>(std::max(list, 1)));
    if (!numbers.ok())
      return Wrong(absl::StrCat("column ", column, ": ", numbers.status().message()));
    return numbers;
  }
  return Wrong(absl::StrCat("has no column ", column, list > 0 ? " of lists" : ""));
}

// Errors without the file's name.
absl::StatusOr<std::vector<double>> ParquetReader::ReadChunk(const ThriftValue& chunk,
                                                             ParquetColumnType type,
                                                             size_t wanted) const {
  const auto wrong = [](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(parts...));
  };
  type.physical = chunk.Integer(1, -1);
  type.codec = chunk.Integer(4, 0);
  if (type.physical != kInt32 && type.physical != kInt64 && type.physical != kFloat &&
      type.physical != kDouble)
    return wrong("values are of type ", type.physical, ", numbers are wanted");
  const int64_t data = chunk.Integer(9, -1), dictionary = chunk.Integer(11, data);
  // Some writers give a dictionary's offset as 0 where there is none.
  const int64_t offset = dictionary > 0 ? std::min(data, dictionary) : data;
  const int64_t size = chunk.Integer(7, -1);
  const auto all = static_cast<int64_t>(bytes_->size());
  if (offset < 4 || offset > all || size < 0 || size > all - offset || size > kMostChunk)
    return wrong(size, " bytes at byte ", offset, " of ", all);
  const std::string bytes = bytes_->Read(static_cast<size_t>(offset), static_cast<size_t>(size));
  std::string_view rest = bytes;
  ParquetPages pages(type, wanted);
  while (pages.numbers().size() < wanted) {
    const auto header = ReadThriftStruct(rest);
    if (!header.ok()) return wrong("page: ", header.status().message());
    rest.remove_prefix(header->second);
    const int64_t page = header->first.Integer(3, -1);
    if (page < 0 || page > static_cast<int64_t>(rest.size()))
      return wrong("a page of ", page, " bytes, ", rest.size(), " are left");
    RS_RETURN_IF_ERROR(pages.Take(header->first, {rest.data(), static_cast<size_t>(page)}));
    rest.remove_prefix(static_cast<size_t>(page));
  }
  return pages.numbers();
}

}  // namespace robostress
