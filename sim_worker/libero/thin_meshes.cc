#include "sim_worker/libero/thin_meshes.h"

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <map>
#include <vector>

namespace robostress::libero {
namespace {

constexpr double kTextureCells = 8;
constexpr int kFewFaces = 1000;  // are drawn as they are

using Cell = std::array<int, 3>;
// Cell; octant of the normal; cell of the texture.
using Key = std::array<int, 6>;

struct Cluster {
  int vertex = 0;  // that stands for it
  int count = 0;
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();
  Eigen::Vector2f texture = Eigen::Vector2f::Zero();
};

struct Mean {
  int count = 0;
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
};

class Mesh {
 public:
  Mesh(mjModel& model, int mesh)
      : vertices_(model.mesh_vertnum[mesh]),
        faces_(model.mesh_facenum[mesh]),
        vert_(model.mesh_vert + 3 * model.mesh_vertadr[mesh]),
        normal_(model.mesh_normal + 3 * model.mesh_vertadr[mesh]),
        texture_(model.mesh_texcoordadr[mesh] < 0
                     ? nullptr
                     : model.mesh_texcoord + 2 * model.mesh_texcoordadr[mesh]),
        face_(model.mesh_face + 3 * model.mesh_faceadr[mesh]) {}

  // The number of faces that are left.
  int Thin(double cell) {
    std::map<Cell, Mean> cells;
    std::map<Key, Cluster> clusters;
    std::vector<const Mean*> cell_of(vertices_);
    std::vector<const Cluster*> cluster_of(vertices_);
    for (int v = 0; v < vertices_; ++v) {
      const Key key = KeyOf(v, cell);
      Mean& mean = cells[{key[0], key[1], key[2]}];
      ++mean.count;
      mean.sum += Position(v);
      cell_of[v] = &mean;
      Cluster& cluster = clusters[key];
      if (cluster.count++ == 0) cluster.vertex = v;
      cluster.normal += Eigen::Map<const Eigen::Vector3f>(normal_ + 3 * v);
      if (texture_ != nullptr)
        cluster.texture += Eigen::Map<const Eigen::Vector2f>(texture_ + 2 * v);
      cluster_of[v] = &cluster;
    }
    int kept = 0;
    for (int f = 0; f < faces_; ++f) {
      int* const corners = face_ + 3 * f;
      const Mean *a = cell_of[corners[0]], *b = cell_of[corners[1]], *c = cell_of[corners[2]];
      if (a == b || b == c || c == a) continue;
      for (int i = 0; i < 3; ++i) face_[3 * kept + i] = cluster_of[corners[i]]->vertex;
      ++kept;
    }
    for (int v = 0; v < vertices_; ++v) Position(v) = cell_of[v]->sum / cell_of[v]->count;
    for (const auto& [key, cluster] : clusters) Shade(cluster);
    return kept;
  }

 private:
  Eigen::Map<Eigen::Vector3f> Position(int v) { return Eigen::Map<Eigen::Vector3f>(vert_ + 3 * v); }

  Key KeyOf(int v, double cell) const {
    Key key{};
    for (int i = 0; i < 3; ++i) {
      key[i] = static_cast<int>(std::floor(vert_[3 * v + i] / cell));
      key[3] |= (normal_[3 * v + i] > 0) << i;
    }
    for (int i = 0; i < 2 && texture_ != nullptr; ++i)
      key[4 + i] = static_cast<int>(std::floor(texture_[2 * v + i] * kTextureCells));
    return key;
  }

  void Shade(const Cluster& cluster) {
    Eigen::Map<Eigen::Vector3f>(normal_ + 3 * cluster.vertex) = cluster.normal.normalized();
    if (texture_ != nullptr)
      Eigen::Map<Eigen::Vector2f>(texture_ + 2 * cluster.vertex) = cluster.texture / cluster.count;
  }

  const int vertices_, faces_;
  float* const vert_;
  float* const normal_;
  float* const texture_;  // null: none
  int* const face_;
};

}  // namespace

void ThinMeshes(mjModel& model, double cell) {
  for (int mesh = 0; mesh < model.nmesh; ++mesh) {
    if (model.mesh_facenum[mesh] > kFewFaces)
      model.mesh_facenum[mesh] = Mesh(model, mesh).Thin(cell);
  }
}

}  // namespace robostress::libero
