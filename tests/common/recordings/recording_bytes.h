#pragma once

#include <lz4frame.h>
#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

// MCAP files and CDR messages byte by byte, by the specifications and without the readers' code.
namespace robostress::recording_test {

template <class T>
std::string Raw(T value) {
  std::string bytes(sizeof(T), '\0');
  std::memcpy(bytes.data(), &value, sizeof(T));
  return bytes;
}
inline std::string McapText(const std::string& text) {
  return Raw(static_cast<uint32_t>(text.size())) + text;
}
inline std::string McapRecord(uint8_t opcode, const std::string& content) {
  return Raw(opcode) + Raw(static_cast<uint64_t>(content.size())) + content;
}
inline std::string McapMagic() { return std::string("\x89MCAP0\r\n", 8); }
inline std::string McapHeader() { return McapRecord(1, McapText("ros2") + McapText("test")); }
inline std::string McapSchemaRecord(uint16_t id, const std::string& name, const std::string& text,
                                    const std::string& encoding = "ros2msg") {
  return McapRecord(3, Raw(id) + McapText(name) + McapText(encoding) + McapText(text));
}
inline std::string McapChannelRecord(uint16_t id, uint16_t schema, const std::string& topic,
                                     const std::string& encoding = "cdr") {
  return McapRecord(4, Raw(id) + Raw(schema) + McapText(topic) + McapText(encoding) + McapText(""));
}
inline std::string McapMessageRecord(uint16_t channel, uint64_t log_ns, const std::string& data) {
  return McapRecord(5, Raw(channel) + Raw(uint32_t{0}) + Raw(log_ns) + Raw(log_ns) + data);
}
inline std::string Packed(const std::string& compression, const std::string& bytes) {
  if (compression == "lz4") {
    std::string packed(LZ4F_compressFrameBound(bytes.size(), nullptr), '\0');
    packed.resize(
        LZ4F_compressFrame(packed.data(), packed.size(), bytes.data(), bytes.size(), nullptr));
    return packed;
  }
  if (compression == "zstd") {
    std::string packed(ZSTD_compressBound(bytes.size()), '\0');
    packed.resize(ZSTD_compress(packed.data(), packed.size(), bytes.data(), bytes.size(), 3));
    return packed;
  }
  return bytes;
}
inline std::string McapChunk(const std::string& compression, const std::string& records) {
  const auto crc = static_cast<uint32_t>(
      crc32_z(0, reinterpret_cast<const Bytef*>(records.data()), records.size()));
  const std::string packed = Packed(compression, records);
  return McapRecord(
      6, Raw(uint64_t{0}) + Raw(uint64_t{0}) + Raw(static_cast<uint64_t>(records.size())) +
             Raw(crc) + McapText(compression) + Raw(static_cast<uint64_t>(packed.size())) + packed);
}
// DataEnd, Footer, magic.
inline std::string McapEnd() {
  return McapRecord(15, Raw(uint32_t{0})) +
         McapRecord(2, Raw(uint64_t{0}) + Raw(uint64_t{0}) + Raw(uint32_t{0})) + McapMagic();
}

// A message in CDR, field by field.
class CdrBytes {
 public:
  // XCDR1 or, with `second`, XCDR2.
  explicit CdrBytes(bool little = true, bool second = false) : little_(little), second_(second) {}

  template <class T>
  CdrBytes& Add(T value) {
    const size_t alignment = second_ ? std::min<size_t>(sizeof(T), 4) : sizeof(T);
    while (body_.size() % alignment != 0) body_ += '\0';
    std::string raw = Raw(value);
    if (!little_) std::reverse(raw.begin(), raw.end());
    body_ += raw;
    return *this;
  }
  CdrBytes& Text(const std::string& text) {
    Add(static_cast<uint32_t>(text.size() + 1));
    body_ += text + '\0';
    return *this;
  }
  CdrBytes& Texts(const std::vector<std::string>& texts) {
    Add(static_cast<uint32_t>(texts.size()));
    for (const std::string& text : texts) Text(text);
    return *this;
  }
  CdrBytes& Numbers(const std::vector<double>& numbers) {
    Add(static_cast<uint32_t>(numbers.size()));
    for (const double number : numbers) Add(number);
    return *this;
  }
  std::string Message() const {
    const char kind = static_cast<char>((second_ ? 6 : 0) + (little_ ? 1 : 0));
    return std::string({'\0', kind, '\0', '\0'}) + body_;
  }

 private:
  const bool little_, second_;
  std::string body_;
};

inline constexpr char kRule[] =
    "================================================================================\n";

inline std::string HeaderTexts() {
  return std::string(kRule) +
         "MSG: std_msgs/Header\n# Two-integer timestamp\nbuiltin_interfaces/Time stamp\n"
         "string frame_id\n" +
         kRule +
         "MSG: builtin_interfaces/Time\nint32 SEC_MAX=5\nint32 sec\n\n# [0, 10e9)\nuint32 "
         "nanosec\n";
}
inline std::string JointStateText() {
  return "# a comment = not a constant\nstd_msgs/Header header\n\nstring[] name\n"
         "float64[] position\nfloat64[] velocity  # [rad/s]\nfloat64[] effort\n" +
         HeaderTexts();
}

struct JointStateFields {
  int64_t stamp_ns = 0;
  std::vector<std::string> name;
  std::vector<double> position, velocity, effort;
};
inline std::string JointStateBytes(const JointStateFields& fields, CdrBytes bytes = CdrBytes()) {
  bytes.Add(static_cast<int32_t>(fields.stamp_ns / 1'000'000'000))
      .Add(static_cast<uint32_t>(fields.stamp_ns % 1'000'000'000))
      .Text("base")
      .Texts(fields.name)
      .Numbers(fields.position)
      .Numbers(fields.velocity)
      .Numbers(fields.effort);
  return bytes.Message();
}

}  // namespace robostress::recording_test
