#include "tests/common/libero/init_file.h"

#include <zlib.h>

#include <cstdint>

namespace robostress::libero {
namespace {

using namespace std::string_literals;

template <class T>
void Put(std::string& out, T value) {
  out.append(reinterpret_cast<const char*>(&value), sizeof(T));
}

std::string Deflated(const std::string& data) {
  z_stream stream = {};
  deflateInit2(&stream, Z_DEFAULT_COMPRESSION, Z_DEFLATED, -MAX_WBITS, 8, Z_DEFAULT_STRATEGY);
  std::string packed(deflateBound(&stream, static_cast<uLong>(data.size())), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(data.data()));
  stream.avail_in = static_cast<uInt>(data.size());
  stream.next_out = reinterpret_cast<Bytef*>(packed.data());
  stream.avail_out = static_cast<uInt>(packed.size());
  deflate(&stream, Z_FINISH);
  packed.resize(stream.total_out);
  deflateEnd(&stream);
  return packed;
}

}  // namespace

std::string Zip(const std::string& name, const std::string& data, uint16_t method) {
  const uint32_t crc =
      crc32(0, reinterpret_cast<const Bytef*>(data.data()), static_cast<uInt>(data.size()));
  const std::string packed = method == 8 ? Deflated(data) : data;
  auto header = [&](std::string& out) {
    Put<uint16_t>(out, method);
    Put<uint32_t>(out, 0);
    Put<uint32_t>(out, crc);
    Put<uint32_t>(out, static_cast<uint32_t>(packed.size()));
    Put<uint32_t>(out, static_cast<uint32_t>(data.size()));
    Put<uint16_t>(out, static_cast<uint16_t>(name.size()));
    Put<uint16_t>(out, 0);
  };
  std::string zip = "PK\x03\x04";
  Put<uint16_t>(zip, 20);
  Put<uint16_t>(zip, 0);
  header(zip);
  zip += name + packed;
  const uint32_t directory = static_cast<uint32_t>(zip.size());
  zip += "PK\x01\x02";
  Put<uint16_t>(zip, 20);
  Put<uint16_t>(zip, 20);
  Put<uint16_t>(zip, 0);
  header(zip);
  zip.append(2 + 2 + 2 + 4, '\0');
  Put<uint32_t>(zip, 0);
  zip += name;
  const uint32_t size = static_cast<uint32_t>(zip.size()) - directory;
  zip += std::string("PK\x05\x06\0\0\0\0\x01\0\x01\0", 12);
  Put<uint32_t>(zip, size);
  Put<uint32_t>(zip, directory);
  Put<uint16_t>(zip, 0);
  return zip;
}

std::string Unicode(const std::string& utf8) {
  std::string out = "X";
  Put<uint32_t>(out, static_cast<uint32_t>(utf8.size()));
  return out + utf8;
}

std::string Pickle(const std::vector<double>& values, int rows, int columns) {
  std::string utf8;
  for (size_t i = 0; i < values.size() * sizeof(double); ++i) {
    const uint8_t byte = reinterpret_cast<const uint8_t*>(values.data())[i];
    if (byte < 0x80) {
      utf8.push_back(static_cast<char>(byte));
    } else {
      utf8.push_back(static_cast<char>(0xc0 | (byte >> 6)));
      utf8.push_back(static_cast<char>(0x80 | (byte & 0x3f)));
    }
  }
  std::string p("\x80\x02", 2);
  p += "cnumpy.core.multiarray\n_reconstruct\nq\0cnumpy\nndarray\nq\1K\0\x85q\2"s;
  p += "c_codecs\nencode\nq\3" + Unicode("b") + Unicode("latin1") + "\x86R\x87R";
  p += "(K\1K" + std::string(1, static_cast<char>(rows)) + "K" +
       std::string(1, static_cast<char>(columns)) + "\x86";
  p += "cnumpy\ndtype\n" + Unicode("f8") + "\x89\x88\x87R(K\3" + Unicode("<") + "NNNJ" +
       std::string(4, '\xff') + "J" + std::string(4, '\xff') + "K\0tb\x89"s;
  p += "h\3" + Unicode(utf8) + Unicode("latin1") + "\x86Rtb.";
  return p;
}

std::string Npy(const std::vector<double>& values, const std::string& shape,
                const std::string& order, const std::string& type) {
  std::string header =
      "{'descr': '" + type + "', 'fortran_order': " + order + ", 'shape': (" + shape + "), }";
  header.append(63 - (header.size() + 10) % 64, ' ');
  header += '\n';
  std::string npy("\x93NUMPY\x01\x00", 8);
  Put<uint16_t>(npy, static_cast<uint16_t>(header.size()));
  npy += header;
  npy.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(double));
  return npy;
}

std::string InitFile(int rows) {
  return Zip("archive/data.pkl", Pickle(std::vector<double>(rows), rows, 1));
}

std::string TaskFile(const std::string& problem) {
  return "(define (problem " + problem + ") (:goal (On bowl plate)))";
}

}  // namespace robostress::libero
