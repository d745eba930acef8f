#include "common/safetensors.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <limits>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/check.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

static_assert(std::endian::native == std::endian::little, "safetensors data is little-endian");

// The reference implementation allows 100 MB; JSON costs ten times its length in memory, and
// pi0.5's has 0.12 MB.
constexpr uint64_t kMaxHeaderBytes = 16'000'000;
constexpr size_t kMaxRank = 8;

struct DTypeInfo {
  DType dtype;
  const char* name;
  int size;
};
constexpr DTypeInfo kDTypes[] = {{DType::kBool, "BOOL", 1}, {DType::kU8, "U8", 1},
                                 {DType::kI8, "I8", 1},     {DType::kI16, "I16", 2},
                                 {DType::kI32, "I32", 4},   {DType::kI64, "I64", 8},
                                 {DType::kF16, "F16", 2},   {DType::kBF16, "BF16", 2},
                                 {DType::kF32, "F32", 4},   {DType::kF64, "F64", 8}};

const DTypeInfo& Info(DType dtype) {
  for (const DTypeInfo& info : kDTypes) {
    if (info.dtype == dtype) return info;
  }
  return kDTypes[0];
}

// Number of bytes of a shape, or nothing when it does not fit 63 bits.
bool BytesOfShape(const std::vector<int64_t>& shape, int element_size, uint64_t& bytes) {
  bytes = element_size;
  for (const int64_t extent : shape) {
    if (__builtin_mul_overflow(bytes, static_cast<uint64_t>(extent), &bytes)) return false;
    if (bytes > static_cast<uint64_t>(std::numeric_limits<int64_t>::max())) return false;
  }
  return true;
}

double HalfToDouble(uint16_t bits) {
  const int exponent = (bits >> 10) & 31, mantissa = bits & 1023;
  const double sign = bits & 0x8000 ? -1.0 : 1.0;
  if (exponent == 31) return mantissa ? std::numeric_limits<double>::quiet_NaN() : sign * HUGE_VAL;
  if (exponent == 0) return sign * std::ldexp(mantissa, -24);
  return sign * std::ldexp(1024 + mantissa, exponent - 25);
}

template <class T>
T LoadAs(const uint8_t* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof(T));
  return value;
}

double ElementAsDouble(DType dtype, const uint8_t* bytes) {
  switch (dtype) {
    case DType::kBool:
    case DType::kU8:
      return *bytes;
    case DType::kI8:
      return LoadAs<int8_t>(bytes);
    case DType::kI16:
      return LoadAs<int16_t>(bytes);
    case DType::kI32:
      return LoadAs<int32_t>(bytes);
    case DType::kI64:
      return static_cast<double>(LoadAs<int64_t>(bytes));
    case DType::kF16:
      return HalfToDouble(LoadAs<uint16_t>(bytes));
    case DType::kBF16:
      return std::bit_cast<float>(uint32_t{LoadAs<uint16_t>(bytes)} << 16);
    case DType::kF32:
      return LoadAs<float>(bytes);
    case DType::kF64:
      return LoadAs<double>(bytes);
  }
  return 0;
}

std::string ShapeText(const std::vector<int64_t>& shape) {
  return absl::StrCat("[", absl::StrJoin(shape, ", "), "]");
}

absl::Status BadFile(const std::string& path, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(path, ": not a usable safetensors file: ", what));
}

absl::StatusOr<TensorView> ParseEntry(const std::string& path, const std::string& name,
                                      const nlohmann::json& entry, absl::Span<const uint8_t> data) {
  const std::string where = absl::StrCat("tensor '", name, "': ");
  if (!entry.is_object()) return BadFile(path, absl::StrCat(where, "is not an object"));
  for (const char* key : {"dtype", "shape", "data_offsets"}) {
    if (!entry.contains(key)) return BadFile(path, absl::StrCat(where, "has no ", key));
  }
  TensorView view;
  const nlohmann::json& dtype = entry["dtype"];
  const DTypeInfo* info = nullptr;
  for (const DTypeInfo& candidate : kDTypes) {
    if (dtype.is_string() && dtype.get<std::string>() == candidate.name) info = &candidate;
  }
  if (info == nullptr)
    return BadFile(path, absl::StrCat(where, "dtype ", dtype.dump(), " is not known"));
  view.dtype = info->dtype;
  const nlohmann::json& shape = entry["shape"];
  if (!shape.is_array() || shape.size() > kMaxRank) {
    return BadFile(path, absl::StrCat(where, "shape ", shape.dump(), " is not a list of at most ",
                                      kMaxRank, " extents"));
  }
  for (const nlohmann::json& extent : shape) {
    if (!extent.is_number_unsigned() || extent.get<uint64_t>() > uint64_t{1} << 48) {
      return BadFile(path, absl::StrCat(where, "extent ", extent.dump(), " is out of range"));
    }
    view.shape.push_back(extent.get<int64_t>());
  }
  const nlohmann::json& offsets = entry["data_offsets"];
  if (!offsets.is_array() || offsets.size() != 2 || !offsets[0].is_number_unsigned() ||
      !offsets[1].is_number_unsigned()) {
    return BadFile(path,
                   absl::StrCat(where, "data_offsets ", offsets.dump(), " is not [begin, end]"));
  }
  const uint64_t begin = offsets[0].get<uint64_t>(), end = offsets[1].get<uint64_t>();
  if (begin > end || end > data.size()) {
    return BadFile(path, absl::StrCat(where, "data_offsets [", begin, ", ", end, "] leave the ",
                                      data.size(), " data bytes; the file may be truncated"));
  }
  uint64_t bytes = 0;
  if (!BytesOfShape(view.shape, info->size, bytes) || bytes != end - begin) {
    return BadFile(path, absl::StrCat(where, "shape ", ShapeText(view.shape), " of ", info->name,
                                      " does not fill its ", end - begin, " bytes"));
  }
  view.bytes = data.subspan(begin, end - begin);
  return view;
}

// The reference format has neither holes nor overlaps.
absl::Status CheckCover(const std::string& path, const std::map<std::string, TensorView>& tensors,
                        absl::Span<const uint8_t> data) {
  std::vector<std::pair<size_t, size_t>> ranges;
  for (const auto& [name, view] : tensors) {
    if (view.bytes.empty()) continue;
    const size_t begin = view.bytes.data() - data.data();
    ranges.emplace_back(begin, begin + view.bytes.size());
  }
  std::sort(ranges.begin(), ranges.end());
  size_t position = 0;
  for (const auto& [begin, end] : ranges) {
    if (begin != position) {
      return BadFile(
          path,
          absl::StrCat("data bytes ", std::min(begin, position), " to ", std::max(begin, position),
                       begin < position ? " belong to two tensors" : " belong to no tensor"));
    }
    position = end;
  }
  if (position != data.size()) {
    return BadFile(path,
                   absl::StrCat(data.size() - position, " bytes at its end belong to no tensor"));
  }
  return absl::OkStatus();
}

}  // namespace

int DTypeSize(DType dtype) { return Info(dtype).size; }
const char* DTypeName(DType dtype) { return Info(dtype).name; }

int64_t TensorView::num_elements() const {
  return static_cast<int64_t>(bytes.size()) / DTypeSize(dtype);
}

struct SafetensorsFile::Storage {
  ~Storage() {
    if (mapping != nullptr) ::munmap(mapping, mapped_size);
  }
  std::string owned;  // of Parse
  void* mapping = nullptr;
  size_t mapped_size = 0;
  absl::Span<const uint8_t> all() const {
    if (mapping != nullptr) return {static_cast<const uint8_t*>(mapping), mapped_size};
    return {reinterpret_cast<const uint8_t*>(owned.data()), owned.size()};
  }
};

SafetensorsFile::SafetensorsFile() = default;
SafetensorsFile::SafetensorsFile(SafetensorsFile&&) noexcept = default;
SafetensorsFile& SafetensorsFile::operator=(SafetensorsFile&&) noexcept = default;
SafetensorsFile::~SafetensorsFile() = default;

absl::StatusOr<SafetensorsFile> SafetensorsFile::Open(const std::string& path) {
  const int fd =
      ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);  // a pipe must not hang us
  if (fd < 0)
    return absl::NotFoundError(absl::StrCat("cannot open '", path, "': ", std::strerror(errno)));
  struct stat info {};
  auto storage = std::make_unique<Storage>();
  void* mapping = MAP_FAILED;
  if (::fstat(fd, &info) == 0 && S_ISREG(info.st_mode) && info.st_size > 0) {
    mapping = ::mmap(nullptr, info.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
  }
  ::close(fd);
  if (mapping == MAP_FAILED) return BadFile(path, "it is empty or not a regular file");
  storage->mapping = mapping;
  storage->mapped_size = info.st_size;
  return ParseStorage(path, std::move(storage));
}

absl::StatusOr<SafetensorsFile> SafetensorsFile::Parse(const std::string& name, std::string bytes) {
  auto storage = std::make_unique<Storage>();
  storage->owned = std::move(bytes);
  return ParseStorage(name, std::move(storage));
}

absl::StatusOr<SafetensorsFile> SafetensorsFile::ParseStorage(const std::string& path,
                                                              std::unique_ptr<Storage> storage) {
  const absl::Span<const uint8_t> all = storage->all();
  if (all.size() < 8)
    return BadFile(
        path, absl::StrCat("it has ", all.size(), " bytes, fewer than the 8 of its header length"));
  const uint64_t header_size = LoadAs<uint64_t>(all.data());
  if (header_size > kMaxHeaderBytes || header_size > all.size() - 8) {
    return BadFile(path, absl::StrCat("its header length ", header_size, " exceeds the file's ",
                                      all.size(), " bytes or the limit of ", kMaxHeaderBytes));
  }
  const auto* header_begin = reinterpret_cast<const char*>(all.data() + 8);
  const absl::StatusOr<nlohmann::json> header = ParseJsonObject({header_begin, header_size});
  if (!header.ok()) return BadFile(path, absl::StrCat("its header: ", header.status().message()));
  SafetensorsFile file;
  file.path_ = path;
  const absl::Span<const uint8_t> data = all.subspan(8 + header_size);
  for (const auto& [name, entry] : header->items()) {
    if (name == "__metadata__") {
      if (!entry.is_object())
        return BadFile(path, absl::StrCat("__metadata__ ", entry.dump(), " is not an object"));
      for (const auto& [key, value] : entry.items()) {
        if (!value.is_string())
          return BadFile(path, absl::StrCat("metadata '", key, "' is not a text"));
        file.metadata_[key] = value.get<std::string>();
      }
      continue;
    }
    RS_ASSIGN_OR_RETURN(file.tensors_[name], ParseEntry(path, name, entry, data));
  }
  RS_RETURN_IF_ERROR(CheckCover(path, file.tensors_, data));
  file.storage_ = std::move(storage);
  return file;
}

uint64_t SafetensorsFile::file_bytes() const { return storage_->all().size(); }

void SafetensorsFile::ReleasePages(absl::Span<const uint8_t> bytes) const {
  if (storage_->mapping == nullptr) return;  // memory of our own has no file to come back from
  const uintptr_t page = static_cast<uintptr_t>(::sysconf(_SC_PAGESIZE));
  const uintptr_t begin = (reinterpret_cast<uintptr_t>(bytes.data()) + page - 1) / page * page;
  const uintptr_t end = reinterpret_cast<uintptr_t>(bytes.data() + bytes.size()) / page * page;
  if (begin < end) ::madvise(reinterpret_cast<void*>(begin), end - begin, MADV_DONTNEED);
}

absl::StatusOr<TensorView> SafetensorsFile::Get(const std::string& name) const {
  const auto found = tensors_.find(name);
  if (found == tensors_.end())
    return absl::NotFoundError(absl::StrCat(path_, ": has no tensor '", name, "'"));
  return found->second;
}

namespace {

template <class T>
absl::StatusOr<std::vector<T>> ReadAs(const std::string& path, const std::string& name,
                                      const TensorView& view, const std::vector<int64_t>& shape) {
  bool match = shape.empty() || shape.size() == view.shape.size();
  for (size_t i = 0; match && i < shape.size(); ++i)
    match = shape[i] == -1 || shape[i] == view.shape[i];
  if (!match) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": tensor '", name, "' has shape ",
                                                   ShapeText(view.shape), ", expected ",
                                                   ShapeText(shape)));
  }
  const int size = DTypeSize(view.dtype);
  std::vector<T> values(view.num_elements());
  for (size_t i = 0; i < values.size(); ++i) {
    values[i] = static_cast<T>(ElementAsDouble(view.dtype, view.bytes.data() + i * size));
  }
  return values;
}

}  // namespace

absl::StatusOr<std::vector<double>> SafetensorsFile::ReadDoubles(
    const std::string& name, const std::vector<int64_t>& shape) const {
  RS_ASSIGN_OR_RETURN(const TensorView view, Get(name));
  return ReadAs<double>(path_, name, view, shape);
}

absl::StatusOr<std::vector<float>> SafetensorsFile::ReadFloats(
    const std::string& name, const std::vector<int64_t>& shape) const {
  RS_ASSIGN_OR_RETURN(const TensorView view, Get(name));
  return ReadAs<float>(path_, name, view, shape);
}

void SafetensorsWriter::Add(const std::string& name, DType dtype, std::vector<int64_t> shape,
                            const void* bytes, size_t size) {
  uint64_t expected = 0;
  RS_CHECK(BytesOfShape(shape, DTypeSize(dtype), expected) && expected == size);
  entries_[name] = {dtype, std::move(shape), std::string(static_cast<const char*>(bytes), size)};
}

void SafetensorsWriter::AddFloats(const std::string& name, std::vector<int64_t> shape,
                                  absl::Span<const float> values) {
  Add(name, DType::kF32, std::move(shape), values.data(), values.size() * sizeof(float));
}

void SafetensorsWriter::AddDoubles(const std::string& name, std::vector<int64_t> shape,
                                   absl::Span<const double> values) {
  Add(name, DType::kF64, std::move(shape), values.data(), values.size() * sizeof(double));
}

void SafetensorsWriter::AddInts(const std::string& name, std::vector<int64_t> shape,
                                absl::Span<const int64_t> values) {
  Add(name, DType::kI64, std::move(shape), values.data(), values.size() * sizeof(int64_t));
}

absl::StatusOr<std::string> SafetensorsWriter::Serialize() const {
  nlohmann::json header = nlohmann::json::object();
  if (!metadata_.empty()) header["__metadata__"] = metadata_;
  // Large elements first keeps every tensor aligned to its element size.
  std::vector<const std::pair<const std::string, Entry>*> order;
  for (const auto& entry : entries_) order.push_back(&entry);
  std::stable_sort(order.begin(), order.end(), [](const auto* a, const auto* b) {
    return DTypeSize(a->second.dtype) > DTypeSize(b->second.dtype);
  });
  uint64_t offset = 0;
  for (const auto* entry : order) {
    const uint64_t end = offset + entry->second.bytes.size();
    header[entry->first] = {{"dtype", DTypeName(entry->second.dtype)},
                            {"shape", entry->second.shape},
                            {"data_offsets", {offset, end}}};
    offset = end;
  }
  std::string text;
  try {
    text = header.dump();
  } catch (const nlohmann::json::exception& error) {
    return absl::InvalidArgumentError(
        absl::StrCat("a tensor name or metadata text is not UTF-8: ", error.what()));
  }
  text.append((8 - text.size() % 8) % 8, ' ');
  const uint64_t header_size = text.size();
  std::string bytes(reinterpret_cast<const char*>(&header_size), 8);
  bytes.reserve(8 + header_size + offset);
  bytes += text;
  for (const auto* entry : order) bytes += entry->second.bytes;
  return bytes;
}

absl::Status SafetensorsWriter::Write(const std::string& path) const {
  RS_ASSIGN_OR_RETURN(const std::string bytes, Serialize());
  return WriteFileAtomically(path, bytes);
}

}  // namespace robostress
