#include "common/recordings/mcap_writer.h"

#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <bit>

#include "absl/strings/str_cat.h"
#include "common/recordings/mcap_format.h"
#include "common/status_macros.h"
#include "common/version.h"

namespace robostress {
namespace {

constexpr int kZstdLevel = 3;
constexpr char kCompression[] = "zstd";

uint32_t CrcOf(absl::string_view bytes, uint32_t before = 0) {
  return static_cast<uint32_t>(
      crc32_z(before, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

// The fields of a record, in order.
class RecordFields {
 public:
  template <class T>
  RecordFields& Number(T value) {
    static_assert(std::endian::native == std::endian::little);
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof(value));
    return *this;
  }
  RecordFields& Bytes(absl::string_view bytes) {
    bytes_.append(bytes.data(), bytes.size());
    return *this;
  }
  RecordFields& Text(absl::string_view text) {
    return Number(static_cast<uint32_t>(text.size())).Bytes(text);
  }
  std::string Record(mcap::Opcode opcode) const {
    return RecordFields()
        .Number(static_cast<uint8_t>(opcode))
        .Number(static_cast<uint64_t>(bytes_.size()))
        .Bytes(bytes_)
        .bytes_;
  }
  const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
};

std::string SchemaRecord(uint16_t id, const McapSchema& schema) {
  return RecordFields()
      .Number(id)
      .Text(schema.name)
      .Text(schema.encoding)
      .Text(schema.text)
      .Record(mcap::kSchema);
}

std::string ChannelRecord(uint16_t id, const McapChannel& channel) {
  return RecordFields()
      .Number(id)
      .Number(channel.schema)
      .Text(channel.topic)
      .Text(channel.encoding)
      .Text("")  // no metadata
      .Record(mcap::kChannel);
}

}  // namespace

absl::StatusOr<McapWriter> McapWriter::Create(const std::string& path, const std::string& profile) {
  RS_ASSIGN_OR_RETURN(AtomicStream file, AtomicStream::Create(path));
  McapWriter writer(std::move(file));
  RS_RETURN_IF_ERROR(writer.Append(mcap::kMagic));
  RS_RETURN_IF_ERROR(writer.Append(RecordFields()
                                       .Text(profile)
                                       .Text(absl::StrCat("robostress ", BuildVersion()))
                                       .Record(mcap::kHeader)));
  return writer;
}

absl::Status McapWriter::Append(absl::string_view bytes) {
  at_ += bytes.size();
  crc_ = CrcOf(bytes, crc_);
  return file_.Append({bytes.data(), bytes.size()});
}

uint16_t McapWriter::AddSchema(const McapSchema& schema) {
  schemas_.push_back(schema);
  const auto id = static_cast<uint16_t>(schemas_.size());
  chunk_ += SchemaRecord(id, schema);
  return id;
}

uint16_t McapWriter::AddChannel(const McapChannel& channel) {
  channels_.push_back({channel, 0, {}});
  const auto id = static_cast<uint16_t>(channels_.size());
  chunk_ += ChannelRecord(id, channel);
  return id;
}

absl::Status McapWriter::Write(uint16_t channel, uint64_t time_ns, absl::string_view data) {
  Channel& of = channels_.at(channel - 1);
  if (data.size() > McapReader::kMostChunk / 2)
    return absl::InvalidArgumentError(absl::StrCat(file_.path(), ": a message of ",
                                                   of.declared.topic, " has ", data.size(),
                                                   " bytes, at most ", McapReader::kMostChunk / 2));
  of.index.emplace_back(time_ns, chunk_.size());
  chunk_ += RecordFields()
                .Number(channel)
                .Number(of.messages++)
                .Number(time_ns)
                .Number(time_ns)
                .Bytes(data)
                .Record(mcap::kMessage);
  chunk_start_ns_ = messages_in_chunk_ == 0 ? time_ns : std::min(chunk_start_ns_, time_ns);
  chunk_end_ns_ = std::max(chunk_end_ns_, time_ns);
  ++messages_in_chunk_;
  return chunk_.size() < kChunkBytes ? absl::OkStatus() : EndChunk();
}

// The chunk, the index of each of its channels, and in the summary section where both stand.
absl::Status McapWriter::EndChunk() {
  std::string packed(ZSTD_compressBound(chunk_.size()), '\0');
  const size_t size =
      ZSTD_compress(packed.data(), packed.size(), chunk_.data(), chunk_.size(), kZstdLevel);
  if (ZSTD_isError(size) != 0)
    return absl::InternalError(absl::StrCat(file_.path(), ": zstd: ", ZSTD_getErrorName(size)));
  packed.resize(size);
  const uint64_t chunk_at = at_, unpacked_bytes = chunk_.size(), packed_bytes = packed.size();
  RS_RETURN_IF_ERROR(Append(RecordFields()
                                .Number(chunk_start_ns_)
                                .Number(chunk_end_ns_)
                                .Number(unpacked_bytes)
                                .Number(CrcOf(chunk_))
                                .Text(kCompression)
                                .Number(packed_bytes)
                                .Bytes(packed)
                                .Record(mcap::kChunk)));
  const uint64_t indexes_at = at_;
  RecordFields offsets;  // map of channel to its index
  for (size_t i = 0; i < channels_.size(); ++i) {
    if (channels_[i].index.empty()) continue;
    const auto id = static_cast<uint16_t>(i + 1);
    offsets.Number(id).Number(at_);
    RecordFields entries;
    for (const auto& [time_ns, byte] : channels_[i].index) entries.Number(time_ns).Number(byte);
    RS_RETURN_IF_ERROR(
        Append(RecordFields().Number(id).Text(entries.bytes()).Record(mcap::kMessageIndex)));
    channels_[i].index.clear();
  }
  chunk_indexes_ += RecordFields()
                        .Number(chunk_start_ns_)
                        .Number(chunk_end_ns_)
                        .Number(chunk_at)
                        .Number(indexes_at - chunk_at)
                        .Text(offsets.bytes())
                        .Number(at_ - indexes_at)
                        .Text(kCompression)
                        .Number(packed_bytes)
                        .Number(unpacked_bytes)
                        .Record(mcap::kChunkIndex);
  start_ns_ = chunks_ == 0 ? chunk_start_ns_ : std::min(start_ns_, chunk_start_ns_);
  end_ns_ = std::max(end_ns_, chunk_end_ns_);
  ++chunks_;
  chunk_.clear();
  chunk_start_ns_ = chunk_end_ns_ = messages_in_chunk_ = 0;
  return absl::OkStatus();
}

absl::Status McapWriter::AddMetadata(const std::string& name,
                                     const std::map<std::string, std::string>& values) {
  RecordFields map;
  for (const auto& [key, value] : values) map.Text(key).Text(value);
  const std::string record = RecordFields().Text(name).Text(map.bytes()).Record(mcap::kMetadata);
  metadata_indexes_ += RecordFields()
                           .Number(at_)
                           .Number(static_cast<uint64_t>(record.size()))
                           .Text(name)
                           .Record(mcap::kMetadataIndex);
  ++metadata_;
  return Append(record);
}

std::string McapWriter::Statistics() const {
  uint64_t messages = 0;
  RecordFields by_channel;
  for (size_t i = 0; i < channels_.size(); ++i) {
    messages += channels_[i].messages;
    by_channel.Number(static_cast<uint16_t>(i + 1))
        .Number(static_cast<uint64_t>(channels_[i].messages));
  }
  return RecordFields()
      .Number(messages)
      .Number(static_cast<uint16_t>(schemas_.size()))
      .Number(static_cast<uint32_t>(channels_.size()))
      .Number(uint32_t{0})  // attachments
      .Number(metadata_)
      .Number(chunks_)
      .Number(start_ns_)
      .Number(end_ns_)
      .Text(by_channel.bytes())
      .Record(mcap::kStatistics);
}

// The summary section and its offsets, from at_ on, with the footer.
std::string McapWriter::Summary() const {
  std::string schemas, channels;
  for (size_t i = 0; i < schemas_.size(); ++i)
    schemas += SchemaRecord(static_cast<uint16_t>(i + 1), schemas_[i]);
  for (size_t i = 0; i < channels_.size(); ++i)
    channels += ChannelRecord(static_cast<uint16_t>(i + 1), channels_[i].declared);
  std::string summary, offsets;
  const auto add = [&](mcap::Opcode opcode, const std::string& group) {
    if (group.empty()) return;
    offsets += RecordFields()
                   .Number(static_cast<uint8_t>(opcode))
                   .Number(at_ + summary.size())
                   .Number(static_cast<uint64_t>(group.size()))
                   .Record(mcap::kSummaryOffset);
    summary += group;
  };
  add(mcap::kSchema, schemas);
  add(mcap::kChannel, channels);
  add(mcap::kStatistics, Statistics());
  add(mcap::kChunkIndex, chunk_indexes_);
  add(mcap::kMetadataIndex, metadata_indexes_);
  const uint64_t offsets_at = at_ + summary.size();
  summary += offsets;
  // The CRC goes up to itself, the opcode and length of the footer included.
  summary +=
      RecordFields().Number(at_).Number(offsets_at).Number(uint32_t{0}).Record(mcap::kFooter);
  summary.resize(summary.size() - sizeof(uint32_t));
  return summary + RecordFields().Number(CrcOf(summary)).bytes();
}

absl::Status McapWriter::Publish() {
  if (!chunk_.empty()) RS_RETURN_IF_ERROR(EndChunk());
  RS_RETURN_IF_ERROR(Append(RecordFields().Number(crc_).Record(mcap::kDataEnd)));
  RS_RETURN_IF_ERROR(Append(Summary()));
  RS_RETURN_IF_ERROR(Append(mcap::kMagic));
  return file_.Publish();
}

}  // namespace robostress
