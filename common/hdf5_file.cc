#include "common/hdf5_file.h"

#include <fcntl.h>
#include <hdf5.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

// The longest text that an attribute may hold [bytes].
constexpr size_t kMaxText = size_t{16} << 20;
constexpr int kMaxRank = 8;
// Bytes that one stored byte can become: deflate's limit is 1032.
constexpr double kMostCompressed = 1032;

// An HDF5 identifier and how it is closed.
class Handle {
 public:
  Handle(hid_t id, herr_t (*close)(hid_t)) : id_(id), close_(close) {}
  ~Handle() {
    if (id_ >= 0) close_(id_);
  }
  Handle(Handle&& other) noexcept : id_(std::exchange(other.id_, -1)), close_(other.close_) {}
  Handle& operator=(Handle&&) = delete;
  bool ok() const { return id_ >= 0; }
  operator hid_t() const { return id_; }

 private:
  hid_t id_;
  herr_t (*close_)(hid_t);
};

// The library prints its own errors and loads filters from anywhere unless told not to. At the
// process's end it would close once more what it could not write on a full disk, and crash.
void QuietLibrary() {
  H5dont_atexit();
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  H5PLset_loading_state(0);
}

std::vector<hsize_t> Extent(const std::vector<int64_t>& shape) {
  return std::vector<hsize_t>(shape.begin(), shape.end());
}

}  // namespace

absl::Status Hdf5File::Fail(const std::string& what, const std::string& object) const {
  return absl::InvalidArgumentError(absl::StrCat(path_, ": ", object, " ", what));
}

absl::StatusOr<Hdf5File> Hdf5File::Open(const std::string& path) {
  QuietLibrary();
  if (access(path.c_str(), R_OK) != 0)
    return absl::NotFoundError(absl::StrCat("'", path, "' cannot be read"));
  Hdf5File file;
  file.path_ = path;
  file.file_ = H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT);
  if (file.file_ < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": not an HDF5 file, or a truncated one; copy it again"));
  }
  return file;
}

absl::StatusOr<Hdf5File> Hdf5File::Create(const std::string& path) {
  QuietLibrary();
  Hdf5File file;
  file.path_ = path;
  file.temporary_ = absl::StrCat(path, ".tmp.", getpid());
  file.file_ = H5Fcreate(file.temporary_.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  if (file.file_ < 0) {
    return absl::UnavailableError(absl::StrCat("cannot create '", file.temporary_,
                                               "'; make its folder and see that there is room"));
  }
  return file;
}

Hdf5File::Hdf5File(Hdf5File&& other) noexcept
    : path_(std::move(other.path_)),
      temporary_(std::exchange(other.temporary_, "")),
      file_(std::exchange(other.file_, -1)) {}

Hdf5File& Hdf5File::operator=(Hdf5File&& other) noexcept {
  std::swap(path_, other.path_);
  std::swap(temporary_, other.temporary_);
  std::swap(file_, other.file_);
  return *this;
}

Hdf5File::~Hdf5File() {
  Close();
  if (!temporary_.empty()) unlink(temporary_.c_str());
}

void Hdf5File::Close() {
  if (file_ >= 0) H5Fclose(std::exchange(file_, -1));
}

absl::Status Hdf5File::Publish() {
  const bool closed = H5Fclose(std::exchange(file_, -1)) >= 0;
  const int handle = open(temporary_.c_str(), O_RDONLY | O_CLOEXEC);
  const bool synced = handle >= 0 && fsync(handle) == 0;
  if (handle >= 0) close(handle);
  if (!closed || !synced || std::rename(temporary_.c_str(), path_.c_str()) != 0) {
    return absl::UnavailableError(
        absl::StrCat("cannot write '", path_, "'; free some space and run again"));
  }
  temporary_.clear();
  return absl::OkStatus();
}

// Every link on the way must be a hard one: a soft or external link leads elsewhere.
absl::Status Hdf5File::CheckLinks(const std::string& name) const {
  std::string way;
  for (const absl::string_view part : absl::StrSplit(name, '/', absl::SkipEmpty())) {
    absl::StrAppend(&way, way.empty() ? "" : "/", part);
    if (H5Lexists(file_, way.c_str(), H5P_DEFAULT) <= 0)
      return absl::NotFoundError(absl::StrCat(path_, ": ", way, " is missing"));
    H5L_info_t info;
    if (H5Lget_info(file_, way.c_str(), &info, H5P_DEFAULT) < 0 || info.type != H5L_TYPE_HARD)
      return Fail("is a link to elsewhere, which is not followed", way);
  }
  return absl::OkStatus();
}

bool Hdf5File::Has(const std::string& name) const { return CheckLinks(name).ok(); }

absl::StatusOr<std::vector<std::string>> Hdf5File::Children(const std::string& group) const {
  RS_RETURN_IF_ERROR(CheckLinks(group));
  const Handle handle(H5Gopen2(file_, group.c_str(), H5P_DEFAULT), H5Gclose);
  H5G_info_t info;
  if (!handle.ok() || H5Gget_info(handle, &info) < 0) return Fail("is not a group", group);
  constexpr hsize_t kMaxChildren = 1 << 20;
  if (info.nlinks > kMaxChildren) {
    return Fail(absl::StrCat("holds ", info.nlinks, " entries, at most ", kMaxChildren), group);
  }
  std::vector<std::string> names;
  for (hsize_t i = 0; i < info.nlinks; ++i) {
    char name[256];
    const ssize_t length = H5Lget_name_by_idx(handle, ".", H5_INDEX_NAME, H5_ITER_INC, i, name,
                                              sizeof(name), H5P_DEFAULT);
    if (length < 0 || length >= static_cast<ssize_t>(sizeof(name)))
      return Fail(absl::StrCat("entry ", i, " has no readable name"), group);
    names.emplace_back(name, length);
  }
  return names;
}

absl::StatusOr<Hdf5Dataset> Hdf5File::Describe(const std::string& name) const {
  RS_RETURN_IF_ERROR(CheckLinks(name));
  const Handle dataset(H5Dopen2(file_, name.c_str(), H5P_DEFAULT), H5Dclose);
  if (!dataset.ok()) return Fail("is not a dataset", name);
  const Handle properties(H5Dget_create_plist(dataset), H5Pclose);
  if (!properties.ok() || H5Pget_external_count(properties) > 0)
    return Fail("is stored in other files, which are not opened", name);
  const Handle space(H5Dget_space(dataset), H5Sclose), type(H5Dget_type(dataset), H5Tclose);
  const int rank = space.ok() ? H5Sget_simple_extent_ndims(space) : -1;
  if (rank < 0 || rank > kMaxRank)
    return Fail(absl::StrCat("has rank ", rank, ", must be 0 to ", kMaxRank), name);
  std::vector<hsize_t> extent(rank);
  H5Sget_simple_extent_dims(space, extent.data(), nullptr);
  Hdf5Dataset result;
  for (const hsize_t length : extent) {
    if (length > hsize_t{1} << 40) return Fail(absl::StrCat("has a length of ", length), name);
    result.shape.push_back(static_cast<int64_t>(length));
  }
  // A file may declare what it does not hold, and the library would fill memory with zeros.
  double declared = type.ok() ? static_cast<double>(H5Tget_size(type)) : 0;
  for (const int64_t length : result.shape) declared *= static_cast<double>(length);
  const double stored = static_cast<double>(H5Dget_storage_size(dataset));
  if (declared > kMostCompressed * stored) {
    return Fail(absl::StrCat("declares ", declared, " bytes and stores ", stored,
                             ", less than any compression needs"),
                name);
  }
  const H5T_class_t kind = type.ok() ? H5Tget_class(type) : H5T_NO_CLASS;
  if (kind != H5T_INTEGER && kind != H5T_FLOAT)
    return Fail("holds neither integers nor floats", name);
  if (kind == H5T_INTEGER && H5Tget_size(type) == 1 && H5Tget_sign(type) == H5T_SGN_NONE)
    result.type = Hdf5Dataset::Type::kUnsignedByte;
  return result;
}

absl::StatusOr<std::vector<double>> Hdf5File::ReadDoubles(const std::string& name,
                                                          std::vector<int64_t> shape, int64_t limit,
                                                          NotFinite numbers) const {
  RS_ASSIGN_OR_RETURN(const Hdf5Dataset found, Describe(name));
  bool fits = found.shape.size() == shape.size();
  int64_t count = 1;
  for (size_t i = 0; fits && i < shape.size(); ++i) {
    fits = shape[i] == -1 ? found.shape[i] <= limit : found.shape[i] == shape[i];
    count *= found.shape[i];
  }
  if (!fits) {
    return Fail(absl::StrCat("is [", absl::StrJoin(found.shape, ","), "], must be [",
                             absl::StrJoin(shape, ","), "], where -1 is up to ", limit),
                name);
  }
  const Handle dataset(H5Dopen2(file_, name.c_str(), H5P_DEFAULT), H5Dclose);
  std::vector<double> values(count);
  if (count > 0 &&
      H5Dread(dataset, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) < 0) {
    return Fail("cannot be read; the file is damaged or needs a filter that is not here", name);
  }
  const auto bad =
      std::find_if(values.begin(), values.end(), [](double v) { return !std::isfinite(v); });
  if (numbers == NotFinite::kRefused && bad != values.end()) {
    return Fail(absl::StrCat("holds ", *bad, " at ", bad - values.begin()), name);
  }
  return values;
}

absl::Status Hdf5File::ReadByteRow(const std::string& name, int64_t row,
                                   absl::Span<uint8_t> bytes) const {
  RS_ASSIGN_OR_RETURN(const Hdf5Dataset found, Describe(name));
  int64_t count = found.shape.empty() ? 0 : 1;
  for (size_t i = 1; i < found.shape.size(); ++i) count *= found.shape[i];
  if (found.type != Hdf5Dataset::Type::kUnsignedByte || row < 0 || found.shape.empty() ||
      row >= found.shape[0] || count != static_cast<int64_t>(bytes.size())) {
    return Fail(absl::StrCat("[", absl::StrJoin(found.shape, ","), "] has no row ", row, " of ",
                             bytes.size(), " bytes"),
                name);
  }
  const Handle dataset(H5Dopen2(file_, name.c_str(), H5P_DEFAULT), H5Dclose);
  const Handle space(H5Dget_space(dataset), H5Sclose);
  std::vector<hsize_t> start(found.shape.size(), 0), extent = Extent(found.shape);
  start[0] = static_cast<hsize_t>(row);
  extent[0] = 1;
  const hsize_t length = bytes.size();
  const Handle memory(H5Screate_simple(1, &length, nullptr), H5Sclose);
  if (H5Sselect_hyperslab(space, H5S_SELECT_SET, start.data(), nullptr, extent.data(), nullptr) <
          0 ||
      H5Dread(dataset, H5T_NATIVE_UINT8, memory, space, H5P_DEFAULT, bytes.data()) < 0) {
    return Fail(absl::StrCat("row ", row,
                             " cannot be read; the file is damaged or needs a filter "
                             "that is not here"),
                name);
  }
  return absl::OkStatus();
}

struct Hdf5File::Attribute {
  std::string full;  // object@name
  Handle handle, type;
};

absl::StatusOr<Hdf5File::Attribute> Hdf5File::OpenAttribute(const std::string& object,
                                                            const std::string& name, int kind,
                                                            const char* what) const {
  RS_RETURN_IF_ERROR(CheckLinks(object));
  std::string full = absl::StrCat(object, "@", name);
  Handle attribute(H5Aopen_by_name(file_, object.c_str(), name.c_str(), H5P_DEFAULT, H5P_DEFAULT),
                   H5Aclose);
  if (!attribute.ok()) return absl::NotFoundError(absl::StrCat(path_, ": ", full, " is missing"));
  Handle type(H5Aget_type(attribute), H5Tclose);
  const Handle space(H5Aget_space(attribute), H5Sclose);
  if (H5Tget_class(type) != kind || H5Sget_simple_extent_npoints(space) != 1)
    return Fail(absl::StrCat("is not ", what), full);
  return Attribute{std::move(full), std::move(attribute), std::move(type)};
}

absl::StatusOr<std::string> Hdf5File::StringAttribute(const std::string& object,
                                                      const std::string& name) const {
  RS_ASSIGN_OR_RETURN(const Attribute attribute,
                      OpenAttribute(object, name, H5T_STRING, "one text"));
  const auto& [full, handle, type] = attribute;
  std::string text;
  if (H5Tis_variable_str(type) > 0) {
    const Handle memory(H5Tcopy(type), H5Tclose);
    char* value = nullptr;
    if (H5Aread(handle, memory, &value) < 0) return Fail("cannot be read", full);
    if (value != nullptr) text = value;
    H5free_memory(value);
  } else {
    const size_t size = H5Tget_size(type);
    if (size > kMaxText) return Fail(absl::StrCat("is ", size, " bytes long"), full);
    text.resize(size);
    if (H5Aread(handle, type, text.data()) < 0) return Fail("cannot be read", full);
    text.resize(std::min(size, text.find('\0')));
  }
  if (text.size() > kMaxText) return Fail(absl::StrCat("is ", text.size(), " bytes long"), full);
  return text;
}

absl::StatusOr<int64_t> Hdf5File::IntAttribute(const std::string& object,
                                               const std::string& name) const {
  RS_ASSIGN_OR_RETURN(const Attribute attribute,
                      OpenAttribute(object, name, H5T_INTEGER, "one integer"));
  int64_t value = 0;
  if (H5Aread(attribute.handle, H5T_NATIVE_INT64, &value) < 0)
    return Fail("cannot be read", attribute.full);
  return value;
}

namespace {

absl::Status Written(bool ok, const std::string& path, const std::string& object) {
  if (ok) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrCat("cannot write ", object, " of '", path, "'; free some space and run again"));
}

bool WriteDataset(hid_t file, const std::string& name, const std::vector<int64_t>& shape,
                  hid_t type, const void* values) {
  const std::vector<hsize_t> extent = Extent(shape);
  const Handle space(H5Screate_simple(static_cast<int>(extent.size()), extent.data(), nullptr),
                     H5Sclose);
  const Handle links(H5Pcreate(H5P_LINK_CREATE), H5Pclose);
  H5Pset_create_intermediate_group(links, 1);
  const Handle dataset(H5Dcreate2(file, name.c_str(), type, space, links, H5P_DEFAULT, H5P_DEFAULT),
                       H5Dclose);
  return dataset.ok() && H5Dwrite(dataset, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, values) >= 0;
}

bool WriteAttribute(hid_t file, const std::string& group, const std::string& name, hid_t type,
                    hid_t space, const void* value) {
  if (H5Lexists(file, group.c_str(), H5P_DEFAULT) <= 0) {
    const Handle made(H5Gcreate2(file, group.c_str(), H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT),
                      H5Gclose);
  }
  const Handle attribute(H5Acreate_by_name(file, group.c_str(), name.c_str(), type, space,
                                           H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT),
                         H5Aclose);
  return attribute.ok() && H5Awrite(attribute, type, value) >= 0;
}

}  // namespace

absl::Status Hdf5File::WriteDoubles(const std::string& name, const std::vector<int64_t>& shape,
                                    absl::Span<const double> values) {
  return Written(WriteDataset(file_, name, shape, H5T_NATIVE_DOUBLE, values.data()), path_, name);
}

absl::Status Hdf5File::WriteBytes(const std::string& name, const std::vector<int64_t>& shape,
                                  absl::Span<const uint8_t> values) {
  return Written(WriteDataset(file_, name, shape, H5T_NATIVE_UINT8, values.data()), path_, name);
}

absl::Status Hdf5File::SetAttribute(const std::string& group, const std::string& name,
                                    const std::string& value) {
  // Variable length, in UTF-8: what h5py writes for a str. Only such text may pass the 64 KiB of an
  // object header, which model_file does.
  const Handle type(H5Tcopy(H5T_C_S1), H5Tclose), space(H5Screate(H5S_SCALAR), H5Sclose);
  H5Tset_size(type, H5T_VARIABLE);
  H5Tset_cset(type, H5T_CSET_UTF8);
  const char* text = value.c_str();
  return Written(WriteAttribute(file_, group, name, type, space, &text), path_,
                 absl::StrCat(group, "@", name));
}

absl::Status Hdf5File::SetAttribute(const std::string& group, const std::string& name,
                                    int64_t value) {
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose);
  return Written(WriteAttribute(file_, group, name, H5T_NATIVE_INT64, space, &value), path_,
                 absl::StrCat(group, "@", name));
}

absl::Status Hdf5File::SetAttribute(const std::string& group, const std::string& name,
                                    absl::Span<const double> values) {
  const hsize_t length = values.size();
  const Handle space(H5Screate_simple(1, &length, nullptr), H5Sclose);
  return Written(WriteAttribute(file_, group, name, H5T_NATIVE_DOUBLE, space, values.data()), path_,
                 absl::StrCat(group, "@", name));
}

}  // namespace robostress
