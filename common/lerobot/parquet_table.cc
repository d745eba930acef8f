#include "common/lerobot/parquet_table.h"

#include <cstring>
#include <limits>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

// Values of parquet.thrift.
enum Physical { kBoolean = 0, kInt64 = 2, kFloat = 4, kByteArray = 6 };
enum Repetition { kRequired = 0, kRepeated = 2 };
constexpr int kUtf8 = 0, kListType = 3, kPlain = 0, kRle = 3;

// Thrift's compact protocol, as far as Parquet's footer needs it.
class Thrift {
 public:
  void Int32(int field, int32_t value) { Begin(field, 5), Varint(ZigZag(value)); }
  void Int64(int field, int64_t value) { Begin(field, 6), Varint(ZigZag(value)); }
  void Text(int field, const std::string& value) { Begin(field, 8), Bytes(value); }
  void Struct(int field) { Begin(field, 12), Open(); }
  void StructList(int field, size_t count) { List(field, 12, count); }
  void Int32List(int field, const std::vector<int32_t>& values) {
    List(field, 5, values.size());
    for (const int32_t value : values) Varint(ZigZag(value));
  }
  void TextList(int field, const std::vector<std::string>& values) {
    List(field, 8, values.size());
    for (const std::string& value : values) Bytes(value);
  }
  // A struct that is an element of a list, or the outermost one.
  void Open() { last_.push_back(0); }
  void Close() {
    out_.push_back(0);
    last_.pop_back();
  }
  const std::string& bytes() const { return out_; }

 private:
  static uint64_t ZigZag(int64_t value) {
    return (static_cast<uint64_t>(value) << 1) ^ static_cast<uint64_t>(value >> 63);
  }
  void Begin(int field, int type) {
    const int delta = field - last_.back();
    if (delta > 0 && delta < 16) {
      out_.push_back(static_cast<char>(delta << 4 | type));
    } else {
      out_.push_back(static_cast<char>(type));
      Varint(ZigZag(field));
    }
    last_.back() = field;
  }
  void List(int field, int type, size_t count) {
    Begin(field, 9);
    if (count < 15) {
      out_.push_back(static_cast<char>(count << 4 | static_cast<size_t>(type)));
    } else {
      out_.push_back(static_cast<char>(0xf0 | type));
      Varint(count);
    }
  }
  void Varint(uint64_t value) {
    for (; value >= 0x80; value >>= 7) out_.push_back(static_cast<char>(value | 0x80));
    out_.push_back(static_cast<char>(value));
  }
  void Bytes(const std::string& value) {
    Varint(value.size());
    out_ += value;
  }

  std::string out_;
  std::vector<int> last_;
};

void PutUint32(uint32_t value, std::string* out) {
  for (int i = 0; i < 4; ++i) out->push_back(static_cast<char>(value >> (8 * i)));
}

// Runs of one level, each 0 or 1, with their length before them.
class Levels {
 public:
  void Run(uint64_t count, int level) {
    for (count <<= 1; count >= 0x80; count >>= 7) runs_.push_back(static_cast<char>(count | 0x80));
    runs_.push_back(static_cast<char>(count));
    runs_.push_back(static_cast<char>(level));
  }
  void AppendTo(std::string* page) const {
    PutUint32(static_cast<uint32_t>(runs_.size()), page);
    *page += runs_;
  }

 private:
  std::string runs_;
};

size_t Count(const ParquetColumn& column) {
  return std::visit([](const auto& values) { return values.size(); }, column.values);
}

Physical TypeOf(const ParquetColumn& column) {
  constexpr Physical kTypes[] = {kBoolean, kInt64, kFloat, kByteArray};
  return kTypes[column.values.index()];
}

void AppendValues(const std::vector<uint8_t>& bits, std::string* page) {
  const size_t first = page->size();
  page->resize(first + (bits.size() + 7) / 8);
  for (size_t i = 0; i < bits.size(); ++i)
    (*page)[first + i / 8] |= static_cast<char>((bits[i] ? 1 : 0) << (i % 8));
}
template <class T>
void AppendNumbers(const std::vector<T>& values, std::string* page) {
  static_assert(std::numeric_limits<float>::is_iec559);
  page->append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
}
void AppendValues(const std::vector<int64_t>& values, std::string* page) {
  AppendNumbers(values, page);
}
void AppendValues(const std::vector<float>& values, std::string* page) {
  AppendNumbers(values, page);
}
void AppendValues(const std::vector<std::string>& values, std::string* page) {
  for (const std::string& value : values) {
    PutUint32(static_cast<uint32_t>(value.size()), page);
    *page += value;
  }
}

std::string Page(const ParquetColumn& column, size_t rows) {
  std::string page;
  if (column.list > 0) {
    Levels repetition, definition;
    for (size_t row = 0; row < rows; ++row) {
      repetition.Run(1, 0);
      if (column.list > 1) repetition.Run(static_cast<uint64_t>(column.list - 1), 1);
    }
    definition.Run(rows * static_cast<size_t>(column.list), 1);
    repetition.AppendTo(&page);
    definition.AppendTo(&page);
  }
  std::visit([&page](const auto& values) { AppendValues(values, &page); }, column.values);
  return page;
}

std::vector<std::string> PathOf(const ParquetColumn& column) {
  if (column.list > 0) return {column.name, "list", "element"};
  if (!column.member.empty()) return {column.name, column.member};
  return {column.name};
}

struct SchemaNode {
  std::string name;
  int type = -1, repetition = -1, children = 0, converted = -1;
};

void PutNode(const SchemaNode& node, Thrift* out) {
  out->Open();
  if (node.type >= 0) out->Int32(1, node.type);
  if (node.repetition >= 0) out->Int32(3, node.repetition);
  out->Text(4, node.name);
  if (node.children > 0) out->Int32(5, node.children);
  if (node.converted >= 0) out->Int32(6, node.converted);
  out->Close();
}

std::vector<SchemaNode> SchemaOf(const std::vector<ParquetColumn>& columns) {
  std::vector<SchemaNode> nodes = {{"schema"}};
  for (size_t i = 0; i < columns.size(); ++i) {
    const ParquetColumn& column = columns[i];
    const int type = TypeOf(column), converted = column.text ? kUtf8 : -1;
    const bool opens = column.member.empty() || i == 0 || columns[i - 1].name != column.name;
    if (opens) ++nodes[0].children;
    if (column.list > 0) {
      nodes.push_back({column.name, -1, kRequired, 1, kListType});
      nodes.push_back({"list", -1, kRepeated, 1});
      nodes.push_back({"element", type, kRequired, 0, converted});
    } else if (column.member.empty()) {
      nodes.push_back({column.name, type, kRequired, 0, converted});
    } else {
      if (opens) {
        int members = 0;
        for (size_t j = i; j < columns.size() && columns[j].name == column.name; ++j) ++members;
        nodes.push_back({column.name, -1, kRequired, members});
      }
      nodes.push_back({column.member, type, kRequired, 0, converted});
    }
  }
  return nodes;
}

std::string PageHeader(size_t bytes, size_t values) {
  Thrift header;
  header.Open();
  header.Int32(1, 0);  // a data page
  header.Int32(2, static_cast<int32_t>(bytes));
  header.Int32(3, static_cast<int32_t>(bytes));
  header.Struct(5);
  header.Int32(1, static_cast<int32_t>(values));
  header.Int32(2, kPlain);
  header.Int32(3, kRle);
  header.Int32(4, kRle);
  header.Close();
  header.Close();
  return header.bytes();
}

struct Chunk {
  int64_t offset, bytes, values;
};

std::string Footer(const std::vector<ParquetColumn>& columns, const std::vector<Chunk>& chunks,
                   size_t rows, const std::vector<std::pair<std::string, std::string>>& metadata) {
  Thrift out;
  out.Open();
  out.Int32(1, 1);
  const std::vector<SchemaNode> schema = SchemaOf(columns);
  out.StructList(2, schema.size());
  for (const SchemaNode& node : schema) PutNode(node, &out);
  out.Int64(3, static_cast<int64_t>(rows));
  out.StructList(4, 1);
  out.Open();
  out.StructList(1, columns.size());
  int64_t total = 0;
  for (size_t i = 0; i < columns.size(); ++i) {
    total += chunks[i].bytes;
    out.Open();
    out.Int64(2, chunks[i].offset);
    out.Struct(3);
    out.Int32(1, TypeOf(columns[i]));
    out.Int32List(2, {kPlain, kRle});
    out.TextList(3, PathOf(columns[i]));
    out.Int32(4, 0);  // not compressed
    out.Int64(5, chunks[i].values);
    out.Int64(6, chunks[i].bytes);
    out.Int64(7, chunks[i].bytes);
    out.Int64(9, chunks[i].offset);
    out.Close();
    out.Close();
  }
  out.Int64(2, total);
  out.Int64(3, static_cast<int64_t>(rows));
  out.Close();
  if (!metadata.empty()) {
    out.StructList(5, metadata.size());
    for (const auto& [key, value] : metadata) {
      out.Open();
      out.Text(1, key);
      out.Text(2, value);
      out.Close();
    }
  }
  out.Text(6, "RoboStress");
  out.Close();
  return out.bytes();
}

}  // namespace

absl::StatusOr<std::string> ParquetTable(
    const std::vector<ParquetColumn>& columns,
    const std::vector<std::pair<std::string, std::string>>& metadata) {
  const auto rows_of = [](const ParquetColumn& column) {
    return column.list > 0 ? Count(column) / static_cast<size_t>(column.list) : Count(column);
  };
  const size_t rows = columns.empty() ? 0 : rows_of(columns[0]);
  std::string file = "PAR1";
  std::vector<Chunk> chunks;
  for (const ParquetColumn& column : columns) {
    if (rows == 0 || rows_of(column) != rows ||
        (column.list > 0 && Count(column) % static_cast<size_t>(column.list) != 0)) {
      return absl::InvalidArgumentError(
          absl::StrCat("column ", column.name, " has ", Count(column), " values for ", rows,
                       " rows", column.list > 0 ? absl::StrCat(" of ", column.list) : ""));
    }
    const std::string page = Page(column, rows);
    if (page.size() > static_cast<size_t>(std::numeric_limits<int32_t>::max())) {
      return absl::InvalidArgumentError(absl::StrCat("column ", column.name, " takes ", page.size(),
                                                     " bytes, at most 2 GiB fit; make episodes "
                                                     "shorter or pictures smaller"));
    }
    const std::string header = PageHeader(page.size(), Count(column));
    chunks.push_back({static_cast<int64_t>(file.size()),
                      static_cast<int64_t>(header.size() + page.size()),
                      static_cast<int64_t>(Count(column))});
    file += header;
    file += page;
  }
  const std::string footer = Footer(columns, chunks, rows, metadata);
  file += footer;
  PutUint32(static_cast<uint32_t>(footer.size()), &file);
  return file + "PAR1";
}

}  // namespace robostress
