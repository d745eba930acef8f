#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "common/models/hull.h"

namespace robostress {

inline Hull BoxOf(const Eigen::Vector3d& low, const Eigen::Vector3d& high) {
  Hull box;
  for (int k = 0; k < 8; ++k)
    box.corners.emplace_back(k & 1 ? high.x() : low.x(), k & 2 ? high.y() : low.y(),
                             k & 4 ? high.z() : low.z());
  return box;
}

// Twelve triangles, outwards.
inline std::vector<Eigen::Vector3d> BoxMesh(const Eigen::Vector3d& low,
                                            const Eigen::Vector3d& high) {
  const Hull box = BoxOf(low, high);
  const int faces[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4},
                           {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  std::vector<Eigen::Vector3d> corners;
  for (const auto& f : faces)
    for (const int k : {0, 1, 2, 0, 2, 3}) corners.push_back(box.corners[f[k]]);
  return corners;
}

inline std::string BinaryStl(const std::vector<Eigen::Vector3d>& corners) {
  std::string text(80, ' ');
  const auto put = [&](auto value) {
    text.append(reinterpret_cast<const char*>(&value), sizeof value);
  };
  put(static_cast<uint32_t>(corners.size() / 3));
  for (size_t i = 0; i + 2 < corners.size(); i += 3) {
    for (int k = 0; k < 3; ++k) put(0.0f);
    for (size_t c = 0; c < 3; ++c)
      for (int k = 0; k < 3; ++k) put(static_cast<float>(corners[i + c][k]));
    put(static_cast<uint16_t>(0));
  }
  return text;
}

}  // namespace robostress
