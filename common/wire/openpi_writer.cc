#include "common/wire/openpi_writer.h"

#define MSGPACK_NO_BOOST  // the C++ standard library has what it would take from there
#include <msgpack.hpp>

namespace robostress {
namespace {

// A sink of msgpack::packer.
struct Appender {
  std::string& bytes;
  void write(const char* data, size_t size) { bytes.append(data, size); }
};

msgpack::packer<Appender> Packer(Appender& appender) { return msgpack::packer<Appender>(appender); }

}  // namespace

OpenpiWriter& OpenpiWriter::Map(uint32_t pairs) {
  Appender to{bytes_};
  Packer(to).pack_map(pairs);
  return *this;
}
OpenpiWriter& OpenpiWriter::List(uint32_t items) {
  Appender to{bytes_};
  Packer(to).pack_array(items);
  return *this;
}
OpenpiWriter& OpenpiWriter::Text(std::string_view text) {
  Appender to{bytes_};
  const auto size = static_cast<uint32_t>(text.size());
  Packer(to).pack_str(size).pack_str_body(text.data(), size);
  return *this;
}
OpenpiWriter& OpenpiWriter::Integer(int64_t value) {
  Appender to{bytes_};
  Packer(to).pack_int64(value);
  return *this;
}
OpenpiWriter& OpenpiWriter::Real(double value) {
  Appender to{bytes_};
  Packer(to).pack_double(value);
  return *this;
}
OpenpiWriter& OpenpiWriter::Boolean(bool value) {
  Appender to{bytes_};
  value ? Packer(to).pack_true() : Packer(to).pack_false();
  return *this;
}

void OpenpiWriter::ArrayKey(std::string_view text) {
  if (keys_ == ArrayKeys::kText) {
    Text(text);
    return;
  }
  Appender to{bytes_};
  const auto size = static_cast<uint32_t>(text.size());
  Packer(to).pack_bin(size).pack_bin_body(text.data(), size);
}

void OpenpiWriter::BeginArray(size_t bytes) {
  Map(4).ArrayKey("__ndarray__");
  Boolean(true).ArrayKey("data");
  Appender to{bytes_};
  Packer(to).pack_bin(static_cast<uint32_t>(bytes));
}

OpenpiWriter& OpenpiWriter::EndArray(std::string_view dtype, std::initializer_list<int64_t> shape) {
  ArrayKey("dtype");
  Text(dtype).ArrayKey("shape");
  List(static_cast<uint32_t>(shape.size()));
  for (const int64_t side : shape) Integer(side);
  return *this;
}

OpenpiWriter& OpenpiWriter::Png(std::string_view png, int width, int height) {
  Map(4).Text("__image__").Boolean(true).Text("format").Text("png").Text("data");
  Appender to{bytes_};
  const auto size = static_cast<uint32_t>(png.size());
  Packer(to).pack_bin(size).pack_bin_body(png.data(), size);
  return Text("shape").List(3).Integer(height).Integer(width).Integer(3);
}

OpenpiWriter& OpenpiWriter::Array(const Eigen::MatrixXf& matrix) {
  const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows = matrix;
  const size_t bytes = static_cast<size_t>(rows.size()) * sizeof(float);
  BeginArray(bytes);
  bytes_.append(reinterpret_cast<const char*>(rows.data()), bytes);
  return EndArray("<f4", {matrix.rows(), matrix.cols()});
}

OpenpiWriter& OpenpiWriter::Numbers(const std::vector<double>& numbers) {
  const size_t bytes = numbers.size() * sizeof(double);
  BeginArray(bytes);
  bytes_.append(reinterpret_cast<const char*>(numbers.data()), bytes);
  return EndArray("<f8", {static_cast<int64_t>(numbers.size())});
}

OpenpiWriter& OpenpiWriter::Pixels(const Image& image, bool planes_first) {
  BeginArray(image.data.size());
  const auto* const data = reinterpret_cast<const char*>(image.data.data());
  if (!planes_first) {
    bytes_.append(data, image.data.size());
    return EndArray("|u1", {image.height, image.width, 3});
  }
  for (size_t channel = 0; channel < 3; ++channel) {
    for (size_t i = channel; i < image.data.size(); i += 3) bytes_.push_back(data[i]);
  }
  return EndArray("|u1", {3, image.height, image.width});
}

OpenpiWriter& OpenpiWriter::Value(std::string_view written) {
  bytes_.append(written);
  return *this;
}

}  // namespace robostress
