#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace robostress {

// What a dataset says of itself. Shapes are checked against what the reader allows before anything
// is read.
struct Hdf5Dataset {
  enum class Type { kUnsignedByte, kNumber };  // 8-bit unsigned; any other integer or float
  Type type = Type::kNumber;
  std::vector<int64_t> shape;
};

// An HDF5 file: groups, numeric datasets and scalar attributes, through Debian's serial library.
// Names are paths from the root ("data/demo_0/actions"). Only what lies in the file itself is
// followed: soft and external links, external storage and filters from plugins are refused, and
// datasets that declare more than they store before memory is taken for them. One
// thread at a time for all files of the process: the library is not thread-safe.
class Hdf5File {
 public:
  // kInvalidArgument where the file is not HDF5 or is truncated.
  static absl::StatusOr<Hdf5File> Open(const std::string& path);
  // Writes to a temporary file beside `path`; Publish makes it appear there.
  static absl::StatusOr<Hdf5File> Create(const std::string& path);
  Hdf5File(Hdf5File&& other) noexcept;
  Hdf5File& operator=(Hdf5File&& other) noexcept;
  ~Hdf5File();  // removes what was not published

  const std::string& path() const { return path_; }
  // What Create writes to; empty once it is published.
  const std::string& temporary() const { return temporary_; }

  // Reading. Errors name file, object and value.
  absl::StatusOr<std::vector<std::string>> Children(const std::string& group) const;
  bool Has(const std::string& name) const;
  absl::StatusOr<Hdf5Dataset> Describe(const std::string& name) const;
  enum class NotFinite { kRefused, kKept };
  // A whole dataset of exactly this shape (-1: any length up to `limit` rows) as doubles.
  absl::StatusOr<std::vector<double>> ReadDoubles(const std::string& name,
                                                  std::vector<int64_t> shape, int64_t limit,
                                                  NotFinite numbers = NotFinite::kRefused) const;
  // Row `row` of a byte dataset [rows, ...], which must be `bytes` long.
  absl::Status ReadByteRow(const std::string& name, int64_t row, absl::Span<uint8_t> bytes) const;
  absl::StatusOr<std::string> StringAttribute(const std::string& object,
                                              const std::string& name) const;
  absl::StatusOr<int64_t> IntAttribute(const std::string& object, const std::string& name) const;

  // Writing. Groups on the way are made.
  absl::Status WriteDoubles(const std::string& name, const std::vector<int64_t>& shape,
                            absl::Span<const double> values);
  absl::Status WriteBytes(const std::string& name, const std::vector<int64_t>& shape,
                          absl::Span<const uint8_t> values);
  absl::Status SetAttribute(const std::string& group, const std::string& name,
                            const std::string& value);
  absl::Status SetAttribute(const std::string& group, const std::string& name, int64_t value);
  absl::Status SetAttribute(const std::string& group, const std::string& name,
                            absl::Span<const double> values);
  // Closes, syncs and renames the file into place.
  absl::Status Publish();

 private:
  Hdf5File() = default;
  absl::Status Fail(const std::string& what, const std::string& object) const;
  absl::Status CheckLinks(const std::string& name) const;
  // Opens object@name, which holds `what`: one value of HDF5's class `kind`.
  struct Attribute;
  absl::StatusOr<Attribute> OpenAttribute(const std::string& object, const std::string& name,
                                          int kind, const char* what) const;
  void Close();

  std::string path_, temporary_;
  int64_t file_ = -1;  // hid_t
};

}  // namespace robostress
