// Columns of numbers of a Parquet file, as LeRobot's data sets have them.
#include <algorithm>
#include <utility>

#include "common/lerobot/parquet_reader.h"
#include "tests/fuzz/fuzz_check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  const std::string name = "file-000.parquet";
  const auto reader =
      ParquetReader::Parse(name, std::string(reinterpret_cast<const char*>(data), size));
  if (!reader.ok()) {
    CheckRefusal(reader.status(), name);
    return 0;
  }
  for (const auto& [column, list] : {std::pair("action", 2), std::pair("timestamp", 0)}) {
    const auto numbers = reader->Numbers(column, list);
    if (!numbers.ok()) {
      CheckRefusal(numbers.status(), name);
      continue;
    }
    const auto wanted =
        static_cast<size_t>(reader->rows()) * static_cast<size_t>(std::max(list, 1));
    FuzzCheck(numbers->size() == wanted, "another number of numbers than rows");
  }
  return 0;
}
