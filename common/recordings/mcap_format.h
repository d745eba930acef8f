#pragma once

#include <cstdint>

#include "absl/strings/string_view.h"

// Constants of https://mcap.dev/spec that the reader and the writer share.
namespace robostress::mcap {

inline constexpr absl::string_view kMagic("\x89MCAP0\r\n", 8);  // at both ends of a file

enum Opcode : uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kMessageIndex = 0x07,
  kChunkIndex = 0x08,
  kStatistics = 0x0b,
  kMetadata = 0x0c,
  kMetadataIndex = 0x0d,
  kSummaryOffset = 0x0e,
  kDataEnd = 0x0f
};

}  // namespace robostress::mcap
