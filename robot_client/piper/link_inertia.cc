#include "robot_client/piper/link_inertia.h"

namespace robostress::piper {
namespace {

// `about_origin`: the tensor's reference is the link's origin, else its centre of mass.
RigidPart Part(double mass, const std::array<double, 3>& centre,
               const std::array<double, 6>& inertia, bool about_origin) {
  RigidPart part;
  part.mass = mass;
  part.centre = Eigen::Vector3d(centre[0], centre[1], centre[2]);
  const auto& i = inertia;  // ixx iyy izz ixy ixz iyz
  Eigen::Matrix3d I;
  I << i[0], i[3], i[4], i[3], i[1], i[5], i[4], i[5], i[2];
  if (about_origin) {
    const Eigen::Vector3d& c = part.centre;
    I -= mass * (c.squaredNorm() * Eigen::Matrix3d::Identity() - c * c.transpose());
    I = I.diagonal().eval().asDiagonal();
  }
  part.inertia = I;
  return part;
}

}  // namespace

// The tensors of links 2, 3 and 5 fit their masses only about the joint's origin (link 2: Iyy is
// 0.0676, of which m x^2 is 0.0554); their products of inertia, whose signs differ from link to
// link, are taken as zero about the centre of mass. Link 6 has a placeholder in the description
// (0.1 kg, 0.001 kg m^2); here it is a disc of 3 cm radius.
const std::array<RigidPart, kJoints>& LinkParts() {
  static const std::array<RigidPart, kJoints> parts = {
      Part(0.71, {0.00032, -0.00041, -0.00348},
           {0.00050027, 0.00040879, 0.00045802, 0.00000078, 0.00000626, 0.00000462}, false),
      Part(1.16, {0.21852, -0.00861, 0.00126},
           {0.00111915, 0.06763251, 0.067559, 0.00182916, 0.00019233, 0.00000767}, true),
      Part(0.50, {-0.01999, -0.14808, -0.00053},
           {0.01347608, 0.00046377, 0.01363321, 0.00161034, 0.00000066, 0.00000162}, true),
      Part(0.38, {0.00013, -0.00076, -0.00394},
           {0.00017844, 0.00018914, 0.00014613, 0.00000062, 0.00000067, 0.00000408}, false),
      Part(0.383, {0.00018, -0.06104, -0.00227},
           {0.00172318, 0.00017936, 0.00171172, 0.00000259, 0.0000001, 0.0000099}, true),
      Part(0.1, {-0.00003, 0.00006, 0.04618}, {3e-5, 3e-5, 4.5e-5, 0, 0, 0}, false)};
  return parts;
}

const RigidPart& GripperPart() {
  static const RigidPart part =
      Part(0.45, {-0.00018, 0.00008, 0.03214},
           {0.00092934, 0.00071447, 0.00039442, 0.00000034, -0.00000738, 0.00000005}, false);
  return part;
}

}  // namespace robostress::piper
