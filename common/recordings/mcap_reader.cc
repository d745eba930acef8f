#include "common/recordings/mcap_reader.h"

#include <zlib.h>

#include <bit>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "common/recordings/mcap_format.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr uint64_t kMostTables = uint64_t{64} << 20;  // bytes of all schemas and channels

// Differences of times below it, and of stamps, fit in 64 bits.
constexpr uint64_t kLastTime = uint64_t{1} << 62;

// Fields of a record in order; `ok` falls where one does not fit, and stays.
class Fields {
 public:
  explicit Fields(absl::string_view bytes) : bytes_(bytes) {}

  template <class T>
  T Number() {
    static_assert(std::endian::native == std::endian::little);
    T value{};
    const absl::string_view raw = Bytes(sizeof(T));
    if (ok_) std::memcpy(&value, raw.data(), sizeof(T));
    return value;
  }
  absl::string_view Bytes(uint64_t count) {
    ok_ = ok_ && count <= bytes_.size();
    if (!ok_) return {};
    const absl::string_view taken = bytes_.substr(0, count);
    bytes_.remove_prefix(count);
    return taken;
  }
  std::string Text() { return std::string(Bytes(Number<uint32_t>())); }
  absl::string_view rest() const { return bytes_; }
  bool ok() const { return ok_; }

 private:
  absl::string_view bytes_;
  bool ok_ = true;
};

}  // namespace

absl::Status McapReader::Wrong(const std::string& what) const {
  return absl::InvalidArgumentError(
      absl::StrCat(source_->path(), ": byte ", record_at_, ": ", what,
                   "; copy the file again, or mend it with `mcap recover`"));
}

absl::StatusOr<std::unique_ptr<McapReader>> McapReader::Open(const std::string& path) {
  RS_ASSIGN_OR_RETURN(std::unique_ptr<ByteSource> source, ByteSource::Open(path));
  std::string magic;
  RS_RETURN_IF_ERROR(source->Read(mcap::kMagic.size(), &magic));
  if (magic != mcap::kMagic)
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": is no MCAP file, its first bytes are not \\x89MCAP0\\r\\n"));
  return std::unique_ptr<McapReader>(new McapReader(std::move(source)));
}

const McapSchema* McapReader::schema(uint16_t id) const {
  const auto found = schemas_.find(id);
  return found == schemas_.end() ? nullptr : &found->second;
}

void McapReader::NoteCut(uint64_t lost) {
  ended_ = true;
  notes_.push_back(
      absl::StrCat(source_->path(), ": ends without a footer, its recorder did not close it; ",
                   chunks_, " whole chunks are read",
                   lost > 0 ? absl::StrCat(", the last ", lost, " bytes are not") : ""));
}

absl::StatusOr<bool> McapReader::Next(McapMessage* message) {
  while (true) {
    if (rest_of_chunk_.empty()) {
      if (ended_) return false;
      RS_ASSIGN_OR_RETURN(const bool found, NextRecord(message));
      if (found) return true;
      continue;
    }
    Fields fields(rest_of_chunk_);
    const auto opcode = fields.Number<uint8_t>();
    const auto length = fields.Number<uint64_t>();
    const absl::string_view content = fields.Bytes(length);
    if (!fields.ok())
      return Wrong(absl::StrCat("a record of ", length, " bytes in a chunk, of which ",
                                rest_of_chunk_.size(), " are left"));
    rest_of_chunk_ = fields.rest();
    if (opcode == mcap::kChunk) return Wrong("a chunk in a chunk");
    RS_ASSIGN_OR_RETURN(const bool found, Take(opcode, content, message));
    if (found) return true;
  }
}

// The next record of the file itself; true: it is a message.
absl::StatusOr<bool> McapReader::NextRecord(McapMessage* message) {
  record_at_ = source_->at();
  RS_RETURN_IF_ERROR(source_->Read(9, &record_));
  if (record_.size() < 9) {
    NoteCut(record_.size());
    return false;
  }
  Fields fields(record_);
  const auto opcode = fields.Number<uint8_t>();
  const auto length = fields.Number<uint64_t>();
  if (opcode == mcap::kDataEnd || opcode == mcap::kFooter) {
    ended_ = true;
    return false;
  }
  const bool wanted = opcode >= mcap::kSchema && opcode <= mcap::kChunk;
  if (!wanted) {
    RS_ASSIGN_OR_RETURN(const uint64_t skipped, source_->Skip(length));
    if (skipped < length) NoteCut(9 + skipped);
    return false;
  }
  if (length > kMostChunk + 1024)
    return Wrong(absl::StrCat("a record of ", length, " bytes, at most ", kMostChunk));
  RS_RETURN_IF_ERROR(source_->Read(length, &record_));
  if (record_.size() < length) {
    NoteCut(9 + record_.size());
    return false;
  }
  return Take(opcode, record_, message);
}

// True: `content` is a message.
absl::StatusOr<bool> McapReader::Take(uint8_t opcode, absl::string_view content,
                                      McapMessage* message) {
  switch (opcode) {
    case mcap::kSchema:
      RS_RETURN_IF_ERROR(TakeSchema(content));
      return false;
    case mcap::kChannel:
      RS_RETURN_IF_ERROR(TakeChannel(content));
      return false;
    case mcap::kChunk:
      RS_RETURN_IF_ERROR(OpenChunk(content));
      return false;
    case mcap::kMessage:
      RS_RETURN_IF_ERROR(TakeMessage(content, message));
      return true;
    default:
      return false;
  }
}

absl::Status McapReader::TakeSchema(absl::string_view content) {
  Fields fields(content);
  const auto id = fields.Number<uint16_t>();
  McapSchema schema{fields.Text(), fields.Text(), fields.Text()};
  if (!fields.ok() || id == 0)
    return Wrong(absl::StrCat("schema ", id, " has fields longer than its record, or id 0"));
  const auto [entry, is_new] = schemas_.try_emplace(id, schema);
  if (!is_new && entry->second != schema)
    return Wrong(absl::StrCat("schema ", id, " is ", schema.name, " and was ", entry->second.name,
                              " of another text before"));
  if (is_new) table_bytes_ += content.size();
  if (table_bytes_ > kMostTables)
    return Wrong(absl::StrCat("schemas of more than ", kMostTables, " bytes"));
  return absl::OkStatus();
}

absl::Status McapReader::TakeChannel(absl::string_view content) {
  Fields fields(content);
  const auto id = fields.Number<uint16_t>();
  McapChannel channel;
  channel.schema = fields.Number<uint16_t>();
  channel.topic = fields.Text();
  channel.encoding = fields.Text();
  if (!fields.ok())
    return Wrong(absl::StrCat("channel ", id, " has fields longer than its record"));
  if (channel.schema != 0 && schemas_.count(channel.schema) == 0)
    return Wrong(absl::StrCat("channel ", id, " (", channel.topic, ") has schema ", channel.schema,
                              ", which does not stand before it"));
  const auto [entry, is_new] = channels_.try_emplace(id, channel);
  if (!is_new && entry->second != channel)
    return Wrong(absl::StrCat("channel ", id, " is ", channel.topic, " and was ",
                              entry->second.topic, " before"));
  if (is_new) table_bytes_ += content.size();
  if (table_bytes_ > kMostTables)
    return Wrong(absl::StrCat("channels of more than ", kMostTables, " bytes"));
  return absl::OkStatus();
}

absl::Status McapReader::TakeMessage(absl::string_view content, McapMessage* message) {
  Fields fields(content);
  message->channel = fields.Number<uint16_t>();
  fields.Number<uint32_t>();  // sequence
  message->log_time_ns = fields.Number<uint64_t>();
  fields.Number<uint64_t>();  // publish time
  message->data = fields.rest();
  if (!fields.ok()) return Wrong(absl::StrCat("a message of ", content.size(), " bytes"));
  if (channels_.count(message->channel) == 0)
    return Wrong(absl::StrCat("a message of channel ", message->channel,
                              ", which does not stand before it"));
  if (message->log_time_ns > kLastTime)
    return Wrong(absl::StrCat("log_time is ", message->log_time_ns, " ns, after the year 2116"));
  return absl::OkStatus();
}

absl::Status McapReader::OpenChunk(absl::string_view content) {
  Fields fields(content);
  fields.Bytes(16);  // start and end time
  const auto size = fields.Number<uint64_t>();
  const auto crc = fields.Number<uint32_t>();
  const std::string compression = fields.Text();
  const absl::string_view packed = fields.Bytes(fields.Number<uint64_t>());
  if (!fields.ok()) return Wrong("a chunk has fields longer than its record");
  if (size > kMostChunk)
    return Wrong(absl::StrCat("a chunk's uncompressed_size is ", size, ", at most ", kMostChunk));
  auto inflated = InflateBlock(compression, packed, size);
  if (!inflated.ok()) return Wrong(absl::StrCat("a chunk ", inflated.status().message()));
  if (inflated->size() != size)
    return Wrong(absl::StrCat("a chunk inflates to ", inflated->size(),
                              " bytes, its uncompressed_size is ", size));
  if (crc != 0) {
    const auto found = static_cast<uint32_t>(
        crc32_z(0, reinterpret_cast<const Bytef*>(inflated->data()), inflated->size()));
    if (found != crc)
      return Wrong(
          absl::StrCat("a chunk's checksum is ", found, ", its uncompressed_crc is ", crc));
  }
  chunk_ = *std::move(inflated);
  rest_of_chunk_ = chunk_;
  ++chunks_;
  return absl::OkStatus();
}

}  // namespace robostress
