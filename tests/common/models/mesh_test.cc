#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <random>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/models/hull.h"
#include "common/models/mesh_file.h"
#include "common/models/mesh_parts.h"
#include "tests/common/models/mesh_samples.h"

namespace robostress {
namespace {

using Eigen::Vector3d;
using ::testing::AllOf;
using ::testing::HasSubstr;

class Random {
 public:
  explicit Random(unsigned seed) : numbers_(seed) {}
  double operator()(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(numbers_);
  }
  Vector3d Vector(double most) {
    return {(*this)(-most, most), (*this)(-most, most), (*this)(-most, most)};
  }
  Eigen::Isometry3d Pose() {
    Eigen::Isometry3d T(Eigen::AngleAxisd((*this)(-3, 3), Vector(1).normalized()));
    T.translation() = Vector(0.5);
    return T;
  }

 private:
  std::mt19937 numbers_;
};

Hull Moved(const Eigen::Isometry3d& T, Hull hull) {
  for (Vector3d& corner : hull.corners) corner = T * corner;
  return hull;
}

// Faces, edges and corners that stand exactly against each other, which is where a simplex is flat.
TEST(Hull, BoxesAlongTheSameAxesAreAsFarAsTheirSides) {
  Random random(2);
  int met = 0;
  for (int k = 0; k < 2000; ++k) {
    Vector3d centre = random.Vector(0.6);
    for (int i = 0; i < 3; ++i)
      if (random(0, 1) < 0.4) centre[i] = 0;
    const Vector3d ha = random.Vector(0.2).cwiseAbs() + Vector3d::Constant(0.01),
                   hb = random.Vector(0.2).cwiseAbs() + Vector3d::Constant(0.01);
    const Eigen::Isometry3d T_world = random.Pose(), T = random.Pose();
    const Hull a = Moved(T_world, BoxOf(-ha, ha));
    const Hull b = Moved(T.inverse() * T_world, BoxOf(centre - hb, centre + hb));
    const Vector3d apart = centre.cwiseAbs() - ha - hb;
    const double distance = Distance(a, b, T);
    if (apart.maxCoeff() > 0) {
      EXPECT_NEAR(distance, apart.cwiseMax(0).norm(), 2e-6) << k;
    } else {
      ++met;
      // The least way out is along a side; other directions may only be longer.
      EXPECT_LE(distance, apart.maxCoeff() + 1e-9) << k;
    }
  }
  EXPECT_GT(met, 200);
}

TEST(Hull, DepthGrowsOnTheWayIn) {
  const Hull box = BoxOf({-0.1, -0.1, -0.1}, {0.1, 0.1, 0.1}), ball{{Vector3d::Zero()}, 0.03};
  double before = 1;
  for (double z = 0.3; z > 0.01; z -= 0.01) {
    const Eigen::Isometry3d T(Eigen::Translation3d(0.02, 0.01, z));
    const double distance = Distance(box, ball, T);
    EXPECT_NEAR(distance, z - 0.1 - 0.03, 1e-6);
    EXPECT_LT(distance, before);
    before = distance;
  }
}

TEST(Hull, EnoughIsSaidOnlyOfWhatIsFurther) {
  Random random(3);
  for (int k = 0; k < 500; ++k) {
    Hull a, b;
    for (int i = 0; i < 20; ++i)
      a.corners.push_back(random.Vector(0.2)), b.corners.push_back(random.Vector(0.2));
    a.radius = 0.04;
    const Eigen::Isometry3d T = random.Pose();
    const double distance = Distance(a, b, T), enough = random(-0.1, 0.5);
    const double quick = Distance(a, b, T, enough);
    EXPECT_LE(quick, distance + 1e-6);
    if (distance <= enough)
      EXPECT_NEAR(quick, distance, 1e-9);
    else
      EXPECT_GT(quick, enough - 1e-6);
    // A plane between them is a proof; some direction shows nearly all of the distance.
    if (distance < 0) continue;
    double proof = -1;
    for (int i = 0; i < 3000; ++i) {
      const Vector3d n = random.Vector(1).normalized();
      double from_a = -1e9, to_b = 1e9;
      for (const Vector3d& c : a.corners) from_a = std::max(from_a, n.dot(c));
      for (const Vector3d& c : b.corners) to_b = std::min(to_b, n.dot(T * c));
      proof = std::max(proof, to_b - from_a - a.radius);
    }
    EXPECT_LE(proof, distance + 1e-6);
    EXPECT_GE(proof, distance - 0.02);
  }
}

std::vector<Vector3d> Angle() {
  std::vector<Vector3d> corners = BoxMesh({0, 0, 0}, {0.3, 0.04, 0.05});
  const std::vector<Vector3d> leg = BoxMesh({0, 0.04, 0}, {0.04, 0.3, 0.05});
  corners.insert(corners.end(), leg.begin(), leg.end());
  return corners;
}

double Nearest(const std::vector<Hull>& parts, const Vector3d& p, double radius) {
  double nearest = 1e9;
  for (const Hull& part : parts)
    nearest = std::min(nearest, Distance(part, {{p}, radius}, Eigen::Isometry3d::Identity()));
  return nearest;
}

TEST(MeshParts, HoldTheSurfaceAndLeaveTheBendFree) {
  const std::vector<Vector3d> corners = Angle();
  const std::vector<Hull> parts = PartsOf(corners, 6), one = PartsOf(corners, 1);
  EXPECT_EQ(one.size(), 1u);
  EXPECT_GE(parts.size(), 2u);
  EXPECT_LE(parts.size(), 6u);
  Random random(4);
  double least = 0;
  for (int k = 0; k < 20000; ++k) {
    const size_t t = 3 * static_cast<size_t>(random(0, corners.size() / 3 - 1e-9));
    double a = random(0, 1), b = random(0, 1);
    if (a + b > 1) a = 1 - a, b = 1 - b;
    const Vector3d p =
        corners[t] + a * (corners[t + 1] - corners[t]) + b * (corners[t + 2] - corners[t]);
    for (const auto* all : {&parts, &one}) ASSERT_LE(Nearest(*all, p, 0), 1e-9) << p.transpose();
    least = std::min(least, Nearest(parts, p, 0));
  }
  EXPECT_GT(least, -0.03) << "inside of a bar of 40 mm";
  // 20 mm from both legs, in the bend.
  EXPECT_NEAR(Nearest(parts, {0.06, 0.06, 0.025}, 0.01), 0.01, 0.002);
  EXPECT_LT(Nearest(one, {0.06, 0.06, 0.025}, 0.01), 0) << "one hull fills it";
}

// Round, more corners than a part has: still all inside, and no more than 3 mm further.
TEST(MeshParts, FollowARoundShape) {
  std::vector<Vector3d> corners;
  constexpr int kRound = 90;
  const auto at = [](int i, int j) -> Vector3d {
    const double a = 2 * M_PI * i / kRound, b = M_PI * j / (kRound / 2);
    return 0.1 * Vector3d(std::cos(a) * std::sin(b), std::sin(a) * std::sin(b), std::cos(b));
  };
  for (int i = 0; i < kRound; ++i)
    for (int j = 0; j < kRound / 2; ++j)
      for (const Vector3d& p :
           {at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i, j + 1)})
        corners.push_back(p);
  const std::vector<Hull> parts = PartsOf(corners, 6);
  Random random(5);
  for (int k = 0; k < 5000; ++k) {
    const Vector3d way = random.Vector(1).normalized();
    ASSERT_LE(Nearest(parts, 0.0999 * way, 0), 0) << way.transpose();
    ASSERT_GT(Nearest(parts, 0.106 * way, 0), 0) << way.transpose();
  }
}

TEST(MeshParts, NothingAndLittleArePossible) {
  EXPECT_TRUE(PartsOf({}, 6).empty());
  const Vector3d p(0.1, 0.2, 0.3);
  const std::vector<Hull> point = PartsOf({p, p, p}, 6);
  ASSERT_EQ(point.size(), 1u);
  EXPECT_LE(Nearest(point, p, 0), 0);
  const std::vector<Hull> flat = PartsOf({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, 6);
  EXPECT_LE(Nearest(flat, {0.3, 0.3, 0}, 0), 0);
  EXPECT_GT(Nearest(flat, {0.3, 0.3, 0.01}, 0), 0.005);
}

// A folder of its own with a mesh in it.
class MeshFolder : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = absl::StrCat(::testing::TempDir(), "meshes_",
                           ::testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  std::string Put(const std::string& name, const std::string& text) {
    const std::string path = folder_ + "/" + name;
    std::filesystem::create_directories(std::filesystem::path(path).parent_path());
    EXPECT_TRUE(WriteFileAtomically(path, text).ok());
    return path;
  }
  static std::string Refusal(const std::string& path) {
    const auto mesh = ReadMesh(path);
    EXPECT_FALSE(mesh.ok());
    return std::string(mesh.status().message());
  }
  std::string folder_;
};

constexpr char kAsciiStl[] =
    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.1 0 0\nvertex 0 0.2 "
    "0\nendloop\nendfacet\nendsolid a\n";
constexpr char kObj[] = "v 0 0 0\nv 0.1 0 0\nv 0.1 0.2 0\nv 0 0.2 0\nf 1 2 3 4\n";
constexpr char kDae[] =
    "<?xml version=\"1.0\"?><COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" "
    "version=\"1.4.1\">"
    "<asset><unit name=\"centimeter\" meter=\"0.01\"/><up_axis>Z_UP</up_axis></asset>"
    "<library_geometries><geometry id=\"g\"><mesh><source id=\"p\"><float_array id=\"f\" "
    "count=\"9\">0 0 0 10 0 0 0 20 0"
    "</float_array><technique_common><accessor source=\"#f\" count=\"3\" stride=\"3\"><param "
    "name=\"X\" type=\"float\"/>"
    "<param name=\"Y\" type=\"float\"/><param name=\"Z\" "
    "type=\"float\"/></accessor></technique_common></source>"
    "<vertices id=\"v\"><input semantic=\"POSITION\" source=\"#p\"/></vertices><triangles "
    "count=\"1\">"
    "<input semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/><p>0 1 "
    "2</p></triangles></mesh></geometry></library_geometries>"
    "<library_visual_scenes><visual_scene id=\"s\"><node id=\"n\"><translate>0 0 30</translate>"
    "<instance_geometry url=\"#g\"/></node></visual_scene></library_visual_scenes>"
    "<scene><instance_visual_scene url=\"#s\"/></scene></COLLADA>";

TEST_F(MeshFolder, StlObjAndColladaAreReadInMetres) {
  const auto binary = ReadMesh(Put("a.STL", BinaryStl(Angle())));
  ASSERT_TRUE(binary.ok()) << binary.status();
  ASSERT_EQ(binary->size(), Angle().size());
  for (size_t i = 0; i < binary->size(); ++i) EXPECT_LT(((*binary)[i] - Angle()[i]).norm(), 1e-7);
  const auto ascii = ReadMesh(Put("b.stl", kAsciiStl));
  ASSERT_TRUE(ascii.ok()) << ascii.status();
  ASSERT_EQ(ascii->size(), 3u);
  EXPECT_NEAR((*ascii)[2].y(), 0.2, 1e-7);
  const auto obj = ReadMesh(Put("c.obj", kObj));
  ASSERT_TRUE(obj.ok()) << obj.status();
  ASSERT_EQ(obj->size(), 6u) << "a square in two triangles";
  EXPECT_EQ((*obj)[5], Vector3d(0, 0.2, 0));
  const auto from_the_end =
      ReadMesh(Put("f.obj", absl::StrReplaceAll(kObj, {{"1 2 3 4", "-4/1 -3/2 -2//1 -1"}})));
  ASSERT_TRUE(from_the_end.ok()) << from_the_end.status();
  EXPECT_EQ(*from_the_end, *obj);
  const auto dae = ReadMesh(Put("d.dae", kDae));
  ASSERT_TRUE(dae.ok()) << dae.status();
  ASSERT_EQ(dae->size(), 3u);
  EXPECT_LT(((*dae)[2] - Vector3d(0, 0.2, 0.3)).norm(), 1e-6) << (*dae)[2].transpose();
  // Which axis is called up changes nothing.
  const auto turned = ReadMesh(Put("e.dae", absl::StrReplaceAll(kDae, {{"Z_UP", "Y_UP"}})));
  ASSERT_TRUE(turned.ok()) << turned.status();
  EXPECT_LT(((*turned)[2] - (*dae)[2]).norm(), 1e-6) << (*turned)[2].transpose();
}

TEST_F(MeshFolder, DamagedFilesAreRefusedByName) {
  const std::string whole = BinaryStl(Angle());
  for (const std::string& text : {std::string(), std::string("solid"), std::string("x"),
                                  whole.substr(0, 83), whole.substr(0, 200)})
    EXPECT_THAT(Refusal(Put("half.stl", text)),
                AllOf(HasSubstr("half.stl"), HasSubstr("put the whole file there")))
        << text.size();
  std::vector<Vector3d> nan = Angle();
  nan[4].y() = std::nan("");
  EXPECT_THAT(Refusal(Put("nan.stl", BinaryStl(nan))), HasSubstr("nan.stl"));
  EXPECT_THAT(Refusal(Put("points.obj", "v 0 0 0\nv 1 0 0\n")), HasSubstr("points.obj"));
  EXPECT_THAT(Refusal(Put("list.dae", "<COLLADA/>")), HasSubstr("list.dae"));
  EXPECT_THAT(Refusal(folder_ + "/none.stl"), HasSubstr("none.stl"));
  EXPECT_THAT(Refusal(Put("far.obj", absl::StrReplaceAll(kObj, {{"3 4", "3 5"}}))),
              HasSubstr("'f 1 2 3 5'"));
  EXPECT_THAT(Refusal(Put("far.dae", absl::StrReplaceAll(kDae, {{"0 1 2<", "0 1 3<"}}))),
              HasSubstr("names corner 3 of 3"));
  EXPECT_THAT(Refusal(Put("circle.dae", absl::StrReplaceAll(kDae, {{"<translate>",
                                                                    "<instance_node url=\"#n\"/>"
                                                                    "<instance_node url=\"#n\"/>"
                                                                    "<translate>"}}))),
              HasSubstr("in a circle"));
  Random random(6);
  for (int k = 0; k < 300; ++k) {
    for (const auto& [name, text] : {std::pair<const char*, std::string>{"f.stl", whole},
                                     {"f.stl", kAsciiStl},
                                     {"f.obj", kObj},
                                     {"f.dae", kDae}}) {
      std::string damaged = text;
      for (int n = 0; n < 3; ++n)
        damaged[static_cast<size_t>(random(0, damaged.size() - 1))] =
            static_cast<char>(random(0, 255));
      const auto mesh = ReadMesh(Put(name, damaged));
      if (!mesh.ok()) continue;
      for (const Vector3d& corner : *mesh) ASSERT_TRUE(corner.allFinite());
    }
  }
}

TEST_F(MeshFolder, AreFoundWhereAPackageIs) {
  const std::string mesh = Put("ws/arm_description/meshes/a.stl", kAsciiStl);
  const std::string urdf = Put("ws/arm_description/urdf/arm.urdf", "");
  const auto found = [](const std::string& where) {
    return std::filesystem::weakly_canonical(where).string();
  };
  EXPECT_EQ(FindMesh("package://arm_description/meshes/a.stl", urdf, {}), found(mesh));
  EXPECT_EQ(FindMesh("package://renamed/meshes/a.stl", urdf, {}), found(mesh))
      << "a clone under another name";
  EXPECT_EQ(FindMesh("../meshes/a.stl", urdf, {}),
            folder_ + "/ws/arm_description/urdf/../meshes/a.stl");
  EXPECT_EQ(FindMesh("file://" + mesh, "/elsewhere/arm.urdf", {}), mesh);
  EXPECT_EQ(FindMesh("package://arm_description/meshes/a.stl", "/elsewhere/arm.urdf", {}), "");
  EXPECT_EQ(
      FindMesh("package://arm_description/meshes/a.stl", "/elsewhere/arm.urdf", {folder_ + "/ws"}),
      mesh);
  EXPECT_EQ(FindMesh("package://arm_description/meshes/a.stl", "/elsewhere/arm.urdf",
                     {folder_ + "/ws/arm_description"}),
            mesh);
  EXPECT_EQ(FindMesh("package://arm_description/meshes/b.stl", urdf, {}), "");
  for (const char* odd : {"", "package://", "package://x", "package:///", "file://", ".."})
    EXPECT_EQ(FindMesh(odd, urdf, {}), "") << odd;
}

}  // namespace
}  // namespace robostress
