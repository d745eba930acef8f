#include "common/libero/zip_entry.h"

#include <zlib.h>

#include <cstdint>
#include <cstring>
#include <optional>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/status_macros.h"

namespace robostress::libero {
namespace {

constexpr uint16_t kStored = 0, kDeflated = 8;

struct Entry {
  std::string name;
  uint16_t method = 0;
  uint32_t crc = 0, packed = 0, size = 0, local = 0;
};

template <class T>
std::optional<T> Load(std::string_view bytes, size_t offset) {
  if (offset > bytes.size() || bytes.size() - offset < sizeof(T)) return std::nullopt;
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof(T));
  return value;
}

absl::Status Broken(const std::string& what) { return absl::InvalidArgumentError(what); }

absl::StatusOr<Entry> FindEntry(std::string_view zip, std::string_view suffix) {
  constexpr uint32_t kEnd = 0x06054b50, kCentral = 0x02014b50;
  constexpr size_t kEndSize = 22, kCentralSize = 46;
  if (zip.size() < kEndSize)
    return Broken(absl::StrCat(zip.size(), " bytes are too few for a zip file"));
  std::optional<size_t> end;
  for (size_t back = 0; back <= 65535 && back + kEndSize <= zip.size() && !end; ++back) {
    const size_t offset = zip.size() - kEndSize - back;
    if (Load<uint32_t>(zip, offset) == kEnd) end = offset;
  }
  if (!end) return Broken("no end-of-central-directory record: not a zip file, or truncated");
  const int entries = *Load<uint16_t>(zip, *end + 10);
  size_t offset = *Load<uint32_t>(zip, *end + 16);
  for (int i = 0; i < entries; ++i) {
    if (Load<uint32_t>(zip, offset) != kCentral || zip.size() - offset < kCentralSize)
      return Broken(absl::StrCat("entry ", i, " of the zip directory is broken"));
    Entry entry;
    entry.method = *Load<uint16_t>(zip, offset + 10);
    entry.crc = *Load<uint32_t>(zip, offset + 16);
    entry.packed = *Load<uint32_t>(zip, offset + 20);
    entry.size = *Load<uint32_t>(zip, offset + 24);
    entry.local = *Load<uint32_t>(zip, offset + 42);
    const uint16_t name_length = *Load<uint16_t>(zip, offset + 28);
    const uint16_t extra_length = *Load<uint16_t>(zip, offset + 30);
    const uint16_t comment_length = *Load<uint16_t>(zip, offset + 32);
    if (zip.size() - offset - kCentralSize < name_length)
      return Broken("a name in the zip directory is cut off");
    entry.name = std::string(zip.substr(offset + kCentralSize, name_length));
    if (entry.name.ends_with(suffix)) return entry;
    offset += kCentralSize + name_length + extra_length + comment_length;
  }
  return absl::NotFoundError(absl::StrCat("no entry ends in '", std::string(suffix), "'"));
}

absl::StatusOr<std::string_view> PackedBytes(std::string_view zip, const Entry& entry) {
  constexpr uint32_t kLocal = 0x04034b50;
  constexpr size_t kLocalSize = 30;
  if (Load<uint32_t>(zip, entry.local) != kLocal || zip.size() - entry.local < kLocalSize)
    return Broken(absl::StrCat("the local header of ", entry.name, " is broken"));
  const size_t begin = size_t{entry.local} + kLocalSize + *Load<uint16_t>(zip, entry.local + 26) +
                       *Load<uint16_t>(zip, entry.local + 28);
  if (begin > zip.size() || zip.size() - begin < entry.packed) {
    return Broken(absl::StrCat(entry.name, " needs ", entry.packed, " bytes at ", begin,
                               ", the file has ", zip.size()));
  }
  return zip.substr(begin, entry.packed);
}

absl::StatusOr<std::string> Inflate(std::string_view packed, const Entry& entry) {
  std::string data(entry.size, '\0');
  z_stream stream = {};
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data()));
  stream.avail_in = static_cast<uInt>(packed.size());
  stream.next_out = reinterpret_cast<Bytef*>(data.data());
  stream.avail_out = static_cast<uInt>(data.size());
  constexpr int kRaw = -MAX_WBITS;  // no header, as zip has it
  bool whole = inflateInit2(&stream, kRaw) == Z_OK;
  whole = whole && inflate(&stream, Z_FINISH) == Z_STREAM_END && stream.avail_out == 0;
  inflateEnd(&stream);
  if (whole) return data;
  return Broken(absl::StrCat(entry.name, " does not unpack to its ", entry.size, " bytes"));
}

}  // namespace

absl::StatusOr<std::string> ReadZipEntry(std::string_view zip, std::string_view suffix,
                                         size_t max_bytes) {
  RS_ASSIGN_OR_RETURN(const Entry entry, FindEntry(zip, suffix));
  if (entry.size > max_bytes) {
    return Broken(absl::StrCat(entry.name, " has ", entry.size, " bytes, at most ", max_bytes,
                               " make sense"));
  }
  if (entry.method != kDeflated && (entry.method != kStored || entry.packed != entry.size)) {
    return Broken(absl::StrCat(entry.name, " is compressed by method ", entry.method,
                               ", expected stored or deflated"));
  }
  RS_ASSIGN_OR_RETURN(const std::string_view packed, PackedBytes(zip, entry));
  std::string data(packed);
  if (entry.method == kDeflated) {
    RS_ASSIGN_OR_RETURN(data, Inflate(packed, entry));
  }
  const uint32_t actual =
      crc32(0, reinterpret_cast<const Bytef*>(data.data()), static_cast<uInt>(data.size()));
  if (actual != entry.crc) {
    return Broken(absl::StrFormat("%s has checksum %08x, the directory says %08x", entry.name,
                                  actual, entry.crc));
  }
  return data;
}

}  // namespace robostress::libero
