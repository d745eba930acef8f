#include "robot_client/can/udp_codec.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <string_view>

namespace robostress {
namespace {

// The first byte of a MessagePack value says its type (github.com/msgpack/msgpack, spec.md).
constexpr uint8_t kNil = 0xC0, kFalse = 0xC2, kTrue = 0xC3, kBin8 = 0xC4, kBin16 = 0xC5,
                  kBin32 = 0xC6, kFloat32 = 0xCA, kFloat64 = 0xCB, kUint8 = 0xCC, kUint64 = 0xCF,
                  kInt8 = 0xD0, kInt64 = 0xD3, kStr8 = 0xD9, kStr32 = 0xDB, kMap16 = 0xDE,
                  kMap32 = 0xDF, kFixStr = 0xA0, kFixMap = 0x80, kNegativeFixInt = 0xE0;

enum Key {
  kTimestamp,
  kArbitrationId,
  kIsExtendedId,
  kIsRemoteFrame,
  kIsErrorFrame,
  kChannel,
  kDlc,
  kData,
  kIsFd,
  kBitrateSwitch,
  kErrorStateIndicator,
  kKeys
};
constexpr std::array<std::string_view, kKeys> kKeyNames = {"timestamp",
                                                           "arbitration_id",
                                                           "is_extended_id",
                                                           "is_remote_frame",
                                                           "is_error_frame",
                                                           "channel",
                                                           "dlc",
                                                           "data",
                                                           "is_fd",
                                                           "bitrate_switch",
                                                           "error_state_indicator"};

class Writer {
 public:
  explicit Writer(uint8_t* out) : begin_(out), out_(out) {}
  void Byte(uint8_t value) { *out_++ = value; }
  void BigEndian(uint64_t value, int bytes) {
    for (int shift = 8 * (bytes - 1); shift >= 0; shift -= 8)
      Byte(static_cast<uint8_t>(value >> shift));
  }
  void Bytes(const void* data, size_t size) {
    std::memcpy(out_, data, size);
    out_ += size;
  }
  void Name(Key key) {
    const std::string_view name = kKeyNames[key];
    Byte(static_cast<uint8_t>(kFixStr | name.size()));
    Bytes(name.data(), name.size());
  }
  void Bool(Key key, bool value) {
    Name(key);
    Byte(value ? kTrue : kFalse);
  }
  size_t size() const { return static_cast<size_t>(out_ - begin_); }

 private:
  uint8_t* begin_;
  uint8_t* out_;
};

// Every function returns false, and is not called again, once the bytes do not fit.
class Reader {
 public:
  explicit Reader(absl::Span<const uint8_t> bytes) : rest_(bytes) {}

  bool Byte(uint8_t& value) {
    if (rest_.empty()) return false;
    value = rest_[0];
    rest_.remove_prefix(1);
    return true;
  }
  bool BigEndian(int bytes, uint64_t& value) {
    if (rest_.size() < static_cast<size_t>(bytes)) return false;
    value = 0;
    for (int i = 0; i < bytes; ++i) value = value << 8 | rest_[i];
    rest_.remove_prefix(bytes);
    return true;
  }
  bool Take(size_t size, absl::Span<const uint8_t>& bytes) {
    if (rest_.size() < size) return false;
    bytes = rest_.first(size);
    rest_.remove_prefix(size);
    return true;
  }
  bool MapSize(uint64_t& size) {
    uint8_t type = 0;
    if (!Byte(type)) return false;
    if ((type & 0xF0) == kFixMap) {
      size = type & 0x0F;
      return true;
    }
    return (type == kMap16 && BigEndian(2, size)) || (type == kMap32 && BigEndian(4, size));
  }
  bool String(absl::Span<const uint8_t>& bytes) {
    uint8_t type = 0;
    return Byte(type) && String(type, bytes);
  }
  bool String(uint8_t type, absl::Span<const uint8_t>& bytes) {
    uint64_t size = 0;
    if ((type & 0xE0) == kFixStr) {
      size = type & 0x1F;
    } else if (type < kStr8 || type > kStr32 || !BigEndian(1 << (type - kStr8), size)) {
      return false;
    }
    return Take(size, bytes);
  }
  bool Binary(absl::Span<const uint8_t>& bytes) {
    uint8_t type = 0;
    uint64_t size = 0;
    return Byte(type) && type >= kBin8 && type <= kBin32 && BigEndian(1 << (type - kBin8), size) &&
           Take(size, bytes);
  }
  bool Bool(bool& value) {
    uint8_t type = 0;
    if (!Byte(type) || (type != kFalse && type != kTrue)) return false;
    value = type == kTrue;
    return true;
  }
  // Non-negative integers in any of their forms.
  bool Unsigned(uint64_t& value) {
    uint8_t type = 0;
    return Byte(type) && Unsigned(type, value);
  }
  bool Unsigned(uint8_t type, uint64_t& value) {
    if (type < 0x80) {
      value = type;
      return true;
    }
    if (type >= kUint8 && type <= kUint64) return BigEndian(1 << (type - kUint8), value);
    if (type < kInt8 || type > kInt64) return false;
    const int bytes = 1 << (type - kInt8);
    return BigEndian(bytes, value) && value >> (8 * bytes - 1) == 0;
  }
  // A time is informative, so that any number will do.
  bool Number() {
    uint8_t type = 0;
    uint64_t value = 0;
    if (!Byte(type)) return false;
    if (type == kFloat32) return BigEndian(4, value);
    if (type == kFloat64) return BigEndian(8, value);
    if (type >= kInt8 && type <= kInt64) return BigEndian(1 << (type - kInt8), value);
    return type >= kNegativeFixInt || Unsigned(type, value);
  }
  bool ChannelName() {
    uint8_t type = 0;
    absl::Span<const uint8_t> bytes;
    return Byte(type) && (type == kNil || String(type, bytes));
  }
  bool empty() const { return rest_.empty(); }

 private:
  absl::Span<const uint8_t> rest_;
};

int FindKey(absl::Span<const uint8_t> name) {
  const std::string_view text(reinterpret_cast<const char*>(name.data()), name.size());
  return static_cast<int>(std::find(kKeyNames.begin(), kKeyNames.end(), text) - kKeyNames.begin());
}

// What a map says; the defaults are python-can's.
struct Fields {
  uint64_t id = 0;
  bool extended = true, remote = false, error = false, fd = false, bitrate_switch = false,
       error_state = false;
  bool has_dlc = false;
  uint64_t dlc = 0;
  absl::Span<const uint8_t> data;
};

bool ReadField(Reader& reader, int key, Fields& fields) {
  switch (key) {
    case kTimestamp:
      return reader.Number();
    case kArbitrationId:
      return reader.Unsigned(fields.id);
    case kIsExtendedId:
      return reader.Bool(fields.extended);
    case kIsRemoteFrame:
      return reader.Bool(fields.remote);
    case kIsErrorFrame:
      return reader.Bool(fields.error);
    case kChannel:
      return reader.ChannelName();
    case kDlc:
      fields.has_dlc = true;
      return reader.Unsigned(fields.dlc);
    case kData:
      return reader.Binary(fields.data);
    case kIsFd:
      return reader.Bool(fields.fd);
    case kBitrateSwitch:
      return reader.Bool(fields.bitrate_switch);
    case kErrorStateIndicator:
      return reader.Bool(fields.error_state);
    default:
      return false;
  }
}

}  // namespace

size_t EncodeUdpCan(const CanFrame& frame, double timestamp_s, uint8_t (&out)[kUdpCanFrameBytes]) {
  Writer writer(out);
  writer.Byte(kFixMap | kKeys);
  writer.Name(kTimestamp);
  writer.Byte(kFloat64);
  writer.BigEndian(std::bit_cast<uint64_t>(timestamp_s), 8);
  writer.Name(kArbitrationId);
  if (frame.id < 0x80) {
    writer.Byte(static_cast<uint8_t>(frame.id));
  } else if (frame.id < 0x100) {
    writer.Byte(kUint8);
    writer.BigEndian(frame.id, 1);
  } else {
    writer.Byte(kUint8 + 1);
    writer.BigEndian(frame.id, 2);
  }
  writer.Bool(kIsExtendedId, false);
  writer.Bool(kIsRemoteFrame, false);
  writer.Bool(kIsErrorFrame, false);
  writer.Name(kChannel);
  writer.Byte(kNil);
  writer.Name(kDlc);
  writer.Byte(frame.size);
  writer.Name(kData);
  writer.Byte(kBin8);
  writer.Byte(frame.size);
  writer.Bytes(frame.data.data(), frame.size);
  writer.Bool(kIsFd, false);
  writer.Bool(kBitrateSwitch, false);
  writer.Bool(kErrorStateIndicator, false);
  return writer.size();
}

bool DecodeUdpCan(absl::Span<const uint8_t> datagram, CanFrame& frame) {
  if (datagram.size() > kMaxUdpCanBytes) return false;
  Reader reader(datagram);
  uint64_t entries = 0;
  if (!reader.MapSize(entries) || entries > kKeys) return false;
  Fields fields;
  uint32_t seen = 0;
  for (uint64_t i = 0; i < entries; ++i) {
    absl::Span<const uint8_t> name;
    if (!reader.String(name)) return false;
    const int key = FindKey(name);
    if (key == kKeys || (seen >> key & 1) != 0) return false;
    seen |= 1u << key;
    if (!ReadField(reader, key, fields)) return false;
  }
  if (!reader.empty()) return false;
  if (fields.extended || fields.remote || fields.error || fields.fd || fields.bitrate_switch ||
      fields.error_state)
    return false;
  if (fields.id > kMaxCanId || fields.data.size() > frame.data.size()) return false;
  if (fields.has_dlc && fields.dlc != fields.data.size()) return false;
  frame.id = static_cast<uint16_t>(fields.id);
  frame.size = static_cast<uint8_t>(fields.data.size());
  frame.data.fill(0);
  std::copy(fields.data.begin(), fields.data.end(), frame.data.begin());
  return true;
}

}  // namespace robostress
