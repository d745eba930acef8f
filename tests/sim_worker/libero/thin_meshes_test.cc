#include "sim_worker/libero/thin_meshes.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "sim_worker/panda_sim.h"

namespace robostress::libero {
namespace {

// A sphere of n rings of 2 n quadrilaterals, 4 n (n - 1) faces, as vertices and faces of a mesh
// asset.
std::string SphereXml(int n, double radius) {
  std::string vertices, faces;
  const auto index = [&](int ring, int side) {
    return ring == 0 ? 0 : ring == n ? 1 : 2 + (ring - 1) * 2 * n + side % (2 * n);
  };
  absl::StrAppend(&vertices, "0 0 ", radius, " 0 0 ", -radius);
  for (int ring = 1; ring < n; ++ring) {
    for (int side = 0; side < 2 * n; ++side) {
      const double polar = std::numbers::pi * ring / n, turn = std::numbers::pi * side / n;
      absl::StrAppend(&vertices, " ", radius * std::sin(polar) * std::cos(turn), " ",
                      radius * std::sin(polar) * std::sin(turn), " ", radius * std::cos(polar));
    }
  }
  for (int ring = 0; ring < n; ++ring) {
    for (int side = 0; side < 2 * n; ++side) {
      const int a = index(ring, side), b = index(ring + 1, side), c = index(ring + 1, side + 1),
                d = index(ring, side + 1);
      if (ring < n - 1) absl::StrAppend(&faces, " ", a, " ", b, " ", c);
      if (ring > 0) absl::StrAppend(&faces, " ", a, " ", c, " ", d);
    }
  }
  return absl::StrCat("<mesh name=\"n", n, "\" vertex=\"", vertices, "\" face=\"", faces, "\"/>");
}

SharedModel Spheres() {
  return CompileModel("spheres",
                      absl::StrCat("<mujoco><asset>", SphereXml(40, 0.1), SphereXml(12, 0.1),
                                   "</asset><worldbody><geom type=\"mesh\" "
                                   "mesh=\"n40\"/><geom type=\"mesh\" mesh=\"n12\"/>"
                                   "</worldbody></mujoco>"))
      .value();
}

Eigen::Vector3f Vertex(const mjModel& model, int mesh, int vertex) {
  return Eigen::Map<const Eigen::Vector3f>(model.mesh_vert +
                                           3 * (model.mesh_vertadr[mesh] + vertex));
}

TEST(ThinMeshes, KeepsTheShapeWithAFractionOfTheTriangles) {
  mjModel* model = mj_copyModel(nullptr, Spheres().get());
  ASSERT_EQ(model->mesh_facenum[0], 4 * 40 * 39);
  const int few = model->mesh_facenum[1];
  constexpr double kCell = 0.02;
  ThinMeshes(*model, kCell);
  EXPECT_EQ(model->mesh_facenum[1], few) << "a mesh of few faces stays";
  EXPECT_LT(model->mesh_facenum[0], 1600);
  EXPECT_GT(model->mesh_facenum[0], 400);
  // Every edge has two faces, by position: no cracks. Every corner is near the sphere.
  std::map<std::vector<float>, int> edges;
  for (int f = 0; f < model->mesh_facenum[0]; ++f) {
    const int* face = model->mesh_face + 3 * (model->mesh_faceadr[0] + f);
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector3f a = Vertex(*model, 0, face[i]),
                            b = Vertex(*model, 0, face[(i + 1) % 3]);
      EXPECT_NE(a, b);
      EXPECT_NEAR(a.norm(), 0.1, kCell / 2);
      std::vector<float> low = {a.x(), a.y(), a.z()}, high = {b.x(), b.y(), b.z()};
      const int way = low < high ? 1 : -1;
      if (way < 0) std::swap(low, high);
      low.insert(low.end(), high.begin(), high.end());
      edges[low] += way;
    }
  }
  for (const auto& [edge, balance] : edges) EXPECT_EQ(balance, 0);
  // Normals still point outwards.
  for (int f = 0; f < model->mesh_facenum[0]; ++f) {
    const int v = model->mesh_face[3 * (model->mesh_faceadr[0] + f)];
    const Eigen::Map<const Eigen::Vector3f> normal(model->mesh_normal +
                                                   3 * (model->mesh_vertadr[0] + v));
    EXPECT_NEAR(normal.norm(), 1, 1e-5);
    EXPECT_GT(normal.dot(Vertex(*model, 0, v).normalized()), 0.9);
  }
  mj_deleteModel(model);
}

}  // namespace
}  // namespace robostress::libero
