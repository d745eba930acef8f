#include "python/library/boundary.h"

namespace robostress {

void WriteMessage(absl::string_view message, char* text, size_t size) {
  if (text == nullptr || size == 0) return;
  size_t count = std::min(message.size(), size - 1);
  if (count < message.size()) {
    while (count > 0 && (static_cast<unsigned char>(message[count]) & 0xC0) == 0x80) --count;
  }
  std::memcpy(text, message.data(), count);
  text[count] = '\0';
}

robostress_code CodeOf(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kOk:
      return ROBOSTRESS_OK;
    case absl::StatusCode::kInvalidArgument:
      return ROBOSTRESS_INVALID_ARGUMENT;
    case absl::StatusCode::kNotFound:
      return ROBOSTRESS_NOT_FOUND;
    case absl::StatusCode::kFailedPrecondition:
      return ROBOSTRESS_WRONG_ORDER;
    case absl::StatusCode::kResourceExhausted:
    case absl::StatusCode::kPermissionDenied:
    case absl::StatusCode::kUnavailable:
      return ROBOSTRESS_STORAGE;
    default:
      return ROBOSTRESS_INTERNAL;
  }
}

}  // namespace robostress
