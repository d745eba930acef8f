#include "common/recordings/byte_source.h"

#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr size_t kBuffer = size_t{1} << 16;

// Of a window that a frame may ask for: 2^27 bytes is what zstd's own program takes.
constexpr int kMostWindowLog = 27;

absl::Status TooLarge(uint64_t most) {
  return absl::InvalidArgumentError(absl::StrCat("inflates to more than ", most, " bytes"));
}

absl::StatusOr<std::string> InflateLz4(absl::string_view packed, uint64_t most) {
  LZ4F_dctx* context = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&context, LZ4F_VERSION)))
    return absl::ResourceExhaustedError("no memory for lz4");
  const absl::Cleanup free = [&] { LZ4F_freeDecompressionContext(context); };
  std::string out, piece(kBuffer, '\0');
  size_t hint = 1;
  while (hint != 0) {
    size_t taken = packed.size(), made = piece.size();
    hint = LZ4F_decompress(context, piece.data(), &made, packed.data(), &taken, nullptr);
    if (LZ4F_isError(hint))
      return absl::InvalidArgumentError(absl::StrCat("is no lz4 frame: ", LZ4F_getErrorName(hint)));
    if (hint != 0 && taken == 0 && made == 0)
      return absl::InvalidArgumentError("is an lz4 frame that ends too early");
    packed.remove_prefix(taken);
    if (made > most - out.size()) return TooLarge(most);
    out.append(piece, 0, made);
  }
  if (!packed.empty())
    return absl::InvalidArgumentError(
        absl::StrCat("has ", packed.size(), " bytes behind its lz4 frame"));
  return out;
}

absl::StatusOr<std::string> InflateZstd(absl::string_view packed, uint64_t most) {
  ZSTD_DCtx* const context = ZSTD_createDCtx();
  const absl::Cleanup free = [&] { ZSTD_freeDCtx(context); };
  ZSTD_DCtx_setParameter(context, ZSTD_d_windowLogMax, kMostWindowLog);
  std::string out, piece(kBuffer, '\0');
  ZSTD_inBuffer in = {packed.data(), packed.size(), 0};
  size_t hint = 1;
  while (hint != 0 || in.pos < in.size) {
    ZSTD_outBuffer made = {piece.data(), piece.size(), 0};
    const size_t before = in.pos;
    hint = ZSTD_decompressStream(context, &made, &in);
    if (ZSTD_isError(hint))
      return absl::InvalidArgumentError(
          absl::StrCat("is no zstd frame: ", ZSTD_getErrorName(hint)));
    if (hint != 0 && in.pos == before && made.pos == 0)
      return absl::InvalidArgumentError("is a zstd frame that ends too early");
    if (made.pos > most - out.size()) return TooLarge(most);
    out.append(piece, 0, made.pos);
  }
  return out;
}

}  // namespace

bool IsZstdName(absl::string_view name) {
  return absl::EndsWith(name, ".zst") || absl::EndsWith(name, ".zstd");
}

absl::StatusOr<std::string> InflateBlock(absl::string_view compression, absl::string_view packed,
                                         uint64_t most) {
  if (compression == "lz4") return InflateLz4(packed, most);
  if (compression == "zstd") return InflateZstd(packed, most);
  if (!compression.empty())
    return absl::InvalidArgumentError(
        absl::StrCat("is compressed by '", compression, "'; read are lz4 and zstd"));
  if (packed.size() > most) return TooLarge(most);
  return std::string(packed);
}

absl::StatusOr<std::unique_ptr<ByteSource>> ByteSource::Open(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error))
    return absl::InvalidArgumentError(
        absl::StrCat("'", path, "' is no file", error ? ": " + error.message() : ""));
  std::unique_ptr<ByteSource> source(new ByteSource);
  source->path_ = path;
  source->file_ = std::fopen(path.c_str(), "rbe");
  if (source->file_ == nullptr)
    return absl::NotFoundError(absl::StrCat("'", path, "' cannot be read: ", std::strerror(errno)));
  source->buffer_.resize(kBuffer);
  if (IsZstdName(path)) {
    source->inflater_ = ZSTD_createDCtx();
    ZSTD_DCtx_setParameter(source->inflater_, ZSTD_d_windowLogMax, kMostWindowLog);
    source->packed_.resize(kBuffer);
  }
  return source;
}

ByteSource::~ByteSource() {
  if (file_ != nullptr) std::fclose(file_);
  if (inflater_ != nullptr) ZSTD_freeDCtx(inflater_);
}

absl::Status ByteSource::Inflate() {
  while (buffer_end_ == 0) {
    if (packed_at_ == packed_end_) {
      packed_end_ = std::fread(packed_.data(), 1, packed_.size(), file_);
      packed_at_ = 0;
      if (packed_end_ == 0) break;
    }
    ZSTD_inBuffer in = {packed_.data(), packed_end_, packed_at_};
    ZSTD_outBuffer made = {buffer_.data(), buffer_.size(), 0};
    const size_t hint = ZSTD_decompressStream(inflater_, &made, &in);
    if (ZSTD_isError(hint))
      return absl::DataLossError(absl::StrCat(path_, ": is damaged at inflated byte ", at_, ": ",
                                              ZSTD_getErrorName(hint), "; copy it again"));
    packed_at_ = in.pos;
    buffer_end_ = made.pos;
  }
  return absl::OkStatus();
}

absl::Status ByteSource::Refill() {
  buffer_at_ = buffer_end_ = 0;
  if (inflater_ != nullptr) {
    RS_RETURN_IF_ERROR(Inflate());
  } else {
    buffer_end_ = std::fread(buffer_.data(), 1, buffer_.size(), file_);
  }
  if (buffer_end_ == 0 && std::ferror(file_) != 0)
    return absl::DataLossError(absl::StrCat(path_, ": cannot be read at byte ", at_, ": ",
                                            std::strerror(errno), "; is the disk in order?"));
  return absl::OkStatus();
}

absl::Status ByteSource::Read(uint64_t count, std::string* bytes) {
  bytes->clear();
  while (bytes->size() < count) {
    if (buffer_at_ == buffer_end_) {
      RS_RETURN_IF_ERROR(Refill());
      if (buffer_end_ == 0) break;
    }
    const size_t some = std::min<uint64_t>(buffer_end_ - buffer_at_, count - bytes->size());
    bytes->append(buffer_, buffer_at_, some);
    buffer_at_ += some;
    at_ += some;
  }
  return absl::OkStatus();
}

absl::StatusOr<uint64_t> ByteSource::Skip(uint64_t count) {
  uint64_t skipped = 0;
  while (skipped < count) {
    if (buffer_at_ == buffer_end_) {
      RS_RETURN_IF_ERROR(Refill());
      if (buffer_end_ == 0) break;
    }
    const size_t some = std::min<uint64_t>(buffer_end_ - buffer_at_, count - skipped);
    buffer_at_ += some;
    skipped += some;
    at_ += some;
  }
  return skipped;
}

}  // namespace robostress
