// The reader of a session's files, as a crash or a bad disk may have left them.
#include "server/sessions/journal/record_file.h"
#include "tests/fuzz/fuzz_check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  for (const bool may_be_torn : {false, true}) {
    uint64_t taken = 0, held = 0;
    const auto extent =
        ReadRecordBytes("journal", bytes, may_be_torn, [&](std::string_view payload) {
          FuzzCheck(payload.data() >= bytes.data() &&
                        payload.data() + payload.size() <= bytes.data() + bytes.size(),
                    "a payload outside the file");
          ++taken;
          held += payload.size();
          return absl::OkStatus();
        });
    if (!extent.ok()) {
      CheckRefusal(extent.status(), "journal");
      continue;
    }
    FuzzCheck(extent->records == taken && extent->bytes == held + 20 * taken, "lost bytes");
    FuzzCheck(extent->torn ? may_be_torn : extent->bytes == size, "an end that is none");
  }
  return 0;
}
