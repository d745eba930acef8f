#include "sim_worker/near_geoms.h"

#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/random.h"
#include "sim_worker/panda_sim.h"
#include "tests/sim_worker/same_contacts.h"

namespace robostress {
namespace {

// Everything that decides which geoms collide, in what order and how: every shape, welded and
// mocap bodies, parents, exclusion, bits, priorities, margins, direct and mixed references, a floor
// on a body of its own, one that touches nothing.
constexpr char kCrowd[] = R"(<mujoco><option timestep="0.002"/><size nconmax="500" njmax="1000"/>
<worldbody>
  <geom type="plane" size="3 3 .1" pos="0 0 -0.3" condim="4" solmix="0"/>
  <geom type="box" size=".3 .02 .1" pos="0 .3 0" margin="0.01" gap="0.004"/>
  <body name="floor"><geom type="plane" size="3 3 .1" pos="0 0 -0.05"/><geom type="sphere" size=".03" pos=".2 0 0"/></body>
  <body name="glass" pos=".3 .3 0"><geom type="plane" size="1 1 .1" contype="0" conaffinity="0"/><geom type="box" size=".1 .1 .03"/></body>
  <body name="shelf" pos="-.3 0 0"><geom type="box" size=".02 .3 .1" solref="-1000 -10"/>
    <geom type="capsule" size=".02 .1" pos="0 .1 .1" contype="0"/>
    <body pos="0 0 .1"><geom type="cylinder" size=".05 .02" priority="2" friction=".3 .2 .1"/></body></body>
  <body name="cart" mocap="true" pos=".2 -.2 0"><geom type="box" size=".05 .06 .02"/><geom type="ellipsoid" size=".03 .02 .05" pos="0 0 .04"/>
    <body pos="0 0 .1"><joint axis="0 1 0"/><geom type="box" size=".02 .02 .05" mass=".1"/></body></body>
  <body name="arm" pos="-.1 -.2 .1"><joint axis="0 0 1"/><geom type="capsule" size=".03" fromto="0 0 0 .15 0 0"/>
    <body pos=".15 0 0"><joint axis="0 1 0"/><geom type="box" size=".05 .02 .02" pos=".05 0 0"/>
      <body pos=".1 0 0"><geom type="sphere" size=".03" solmix="3"/>
        <body name="hand" pos=".03 0 0"><joint axis="1 0 0"/><geom type="box" size=".01 .06 .01"/><geom type="box" size=".01 .01 .04" pos="0 .06 0" condim="6"/></body></body></body></body>
  <body name="a" pos="0 0 .1"><freejoint/><geom type="box" size=".05 .04 .03"/><geom type="box" size=".02 .02 .06" pos=".05 0 .02" contype="2" conaffinity="3"/></body>
  <body name="b" pos=".1 0 .1"><freejoint/><geom type="sphere" size=".04" priority="1"/><geom type="capsule" size=".02 .05" pos="0 .05 0" margin=".02"/></body>
  <body name="c" pos="0 .1 .1"><freejoint/><geom type="ellipsoid" size=".03 .05 .02"/><geom type="box" size=".3 .3 .3" contype="0" conaffinity="0"/></body>
  <body name="d" pos=".1 .1 .1"><freejoint/><geom type="cylinder" size=".04 .03"/><geom type="mesh" mesh="wedge" pos=".03 0 0"/></body>
  <body name="e" pos="-.1 .1 .1"><freejoint/><geom type="mesh" mesh="wedge"/><geom type="box" size=".04 .01 .04" solmix="0"/></body>
</worldbody>
<contact><exclude body1="a" body2="d"/><exclude body1="hand" body2="shelf"/></contact>
<asset><mesh name="wedge" vertex="0 0 0  .06 0 0  0 .05 0  0 0 .07  .04 .04 .03"/></asset></mujoco>)";

struct Twins {
  explicit Twins(const SharedModel& m) : Twins(*m) {}
  explicit Twins(const mjModel& m)
      : model(m), ours(mj_makeData(&m)), theirs(mj_makeData(&m)), near(m) {}
  ~Twins() {
    mj_deleteData(ours);
    mj_deleteData(theirs);
  }
  void Compare() {
    mj_kinematics(&model, ours);
    near.Collide(*ours);
    CollideAlike(model, *ours, *theirs);
    ExpectSameContacts(*ours, *theirs);
  }

  const mjModel& model;
  mjData *ours, *theirs;
  NearGeoms near;
};

TEST(NearGeoms, ContactsAreMuJoCosToTheBit) {
  const absl::StatusOr<SharedModel> model = CompileModel("crowd", kCrowd);
  ASSERT_TRUE(model.ok()) << model.status();
  Twins twins(*model);
  mjData& d = *twins.ours;
  const int nv = (*model)->nv;
  RandomStream random(StreamKey("near geoms"));
  int contacts = 0, twice = 0, excluded = 0;
  std::vector<double> velocity(nv);
  for (int i = 0; i < 6000; ++i) {
    if (i % 40 == 0) {  // elsewhere
      mj_resetData(model->get(), &d);
      for (double& v : velocity) v = random.Normal();
      mj_integratePos(model->get(), d.qpos, velocity.data(), 0.2);
      for (double& v : velocity) v = random.Normal();
      for (int k = 0; k < 3; ++k) d.mocap_pos[k] += 0.1 * random.Normal();
    }
    mj_integratePos(model->get(), d.qpos, velocity.data(), 0.002);
    d.mocap_pos[i % 3] += 0.001 * random.Normal();
    d.mocap_quat[i % 4] += 0.02 * random.Normal();
    mju_normalize4(d.mocap_quat);
    ASSERT_NO_FATAL_FAILURE(twins.Compare()) << "at " << i;
    contacts += d.ncon;
    std::set<std::tuple<int, int, double, double>> seen;
    for (int k = 0; k < d.ncon; ++k) {
      const mjContact& c = d.contact[k];
      twice += !seen.insert({c.geom1, c.geom2, c.pos[0], c.pos[1]}).second;
      excluded += c.exclude;
    }
  }
  EXPECT_GT(contacts, 20000);
  EXPECT_GT(twice, 100) << "MuJoCo's contacts with a floor on a body were meant to be met";
  EXPECT_GT(excluded, 10) << "no contact lay within a gap";
}

TEST(NearGeoms, ABarThatTurnsAboutItsMiddleMeetsAPost) {
  const absl::StatusOr<SharedModel> model = CompileModel("bar", R"(<mujoco><worldbody>
    <geom type="box" size=".02 .02 .1" pos="0 .2 0"/>
    <body><joint axis="0 0 1"/><geom type="box" size=".25 .01 .01"/></body></worldbody></mujoco>)");
  ASSERT_TRUE(model.ok()) << model.status();
  Twins twins(*model);
  int touching = 0;
  for (int i = 0; i < 160; ++i) {
    twins.ours->qpos[0] = 0.01 * i;
    ASSERT_NO_FATAL_FAILURE(twins.Compare()) << "at " << i;
    touching += twins.ours->ncon > 0;
  }
  EXPECT_GT(touching, 10);
}

// To MuJoCo's broad phase it is smaller, to its near phase it is not.
TEST(NearGeoms, AMarginBelowNoughtIsLeftToMuJoCo) {
  const absl::StatusOr<SharedModel> model = CompileModel("margin", R"(<mujoco><worldbody>
    <body><freejoint/><geom type="sphere" size=".05" margin="-.02"/></body>
    <body pos=".15 0 0"><freejoint/><geom type="sphere" size=".05"/></body></worldbody></mujoco>)");
  ASSERT_TRUE(model.ok()) << model.status();
  Twins twins(*model);
  int touching = 0;
  for (int i = 0; i < 120; ++i) {
    twins.ours->qpos[0] = 0.001 * i;
    ASSERT_NO_FATAL_FAILURE(twins.Compare()) << "at " << i;
    touching += twins.ours->ncon > 0;
  }
  EXPECT_LT(touching, 60);
  EXPECT_GT(touching, 10);
}

// What is told of by Forget, and what needs no word.
TEST(NearGeoms, TheModelMayChangeBetweenSteps) {
  const absl::StatusOr<SharedModel> compiled = CompileModel("crowd", kCrowd);
  ASSERT_TRUE(compiled.ok()) << compiled.status();
  mjModel* model = mj_copyModel(nullptr, compiled->get());
  auto* const warn = std::exchange(mju_user_warning, [](const char*) {});
  {
    Twins twins(*model);
    RandomStream random(StreamKey("near geoms of a model that changes"));
    std::vector<double> velocity(model->nv);
    int with_parents = 0, full = 0, unmoved = 0;
    for (int i = 0; i < 400; ++i) {
      mj_resetData(model, twins.ours);
      for (double& v : velocity) v = random.Normal();
      mj_integratePos(model, twins.ours->qpos, velocity.data(), 0.1);
      const auto compare = [&] {
        twins.theirs->warning[mjWARN_CONTACTFULL].number = 0;
        ASSERT_NO_FATAL_FAILURE(twins.Compare()) << "at " << i;
      };
      compare();
      const int before = twins.ours->ncon;
      for (const int flag : {mjDSBL_FILTERPARENT, mjDSBL_CONTACT}) {
        model->opt.disableflags ^= flag;
        compare();
        with_parents += flag == mjDSBL_FILTERPARENT && twins.ours->ncon > before;
        model->opt.disableflags ^= flag;
        compare();
      }
      model->opt.enableflags ^= mjENBL_OVERRIDE;
      compare();
      model->opt.enableflags ^= mjENBL_OVERRIDE;
      model->nconmax = 3;
      compare();
      full += twins.ours->warning[mjWARN_CONTACTFULL].number > 0;
      model->nconmax = compiled->get()->nconmax;
      for (int geom = 0; geom < model->ngeom; ++geom)
        model->geom_friction[3 * geom] = random.Uniform();
      const int shelf = mj_name2id(model, mjOBJ_BODY, "shelf");
      model->body_pos[3 * shelf] = random.Uniform(-0.3, 0.3);
      twins.near.Forget();
      compare();
      unmoved += twins.ours->ncon == before;
    }
    EXPECT_GT(with_parents, 10);
    EXPECT_GT(full, 10);
    EXPECT_LT(unmoved, 390);
  }
  mju_user_warning = warn;
  mj_deleteModel(model);
}

TEST(NearGeoms, LeavesToMuJoCoWhatItDoesNotKnow) {
  const std::string crowd = kCrowd;
  const auto with = [&](const std::string& what, const std::string& instead) {
    std::string changed = crowd;
    const size_t at = changed.find(what);
    EXPECT_NE(at, std::string::npos) << what;
    return changed.replace(at, what.size(), instead);
  };
  for (const std::string& scene :
       {with("<option ", "<option collision=\"predefined\" "),
        with("<option timestep=\"0.002\"/>",
             "<option o_margin=\".05\"><flag override=\"enable\"/></option>"),
        with("<exclude", "<pair geom1=\"w\" geom2=\"s\" margin=\".3\"/><exclude"),
        with("mocap=\"true\" pos=\".2 -.2 0\">",
             "mocap=\"true\" pos=\".2 -.2 0\"><geom type=\"plane\" size=\"1 1 1\"/>")}) {
    std::string named = scene;
    named.replace(named.find("<geom type=\"box\" size=\".3 .02"), 5, "<geom name=\"w\"");
    named.replace(named.find("<geom type=\"sphere\" size=\".04"), 5, "<geom name=\"s\"");
    const absl::StatusOr<SharedModel> model = CompileModel("scene", named);
    ASSERT_TRUE(model.ok()) << model.status();
    Twins twins(*model);
    std::vector<double> velocity((*model)->nv, 0.3);
    for (int i = 0; i < 200; ++i) {
      mj_integratePos(model->get(), twins.ours->qpos, velocity.data(), 0.002);
      twins.ours->mocap_quat[1] += 0.005;
      mju_normalize4(twins.ours->mocap_quat);
      ASSERT_NO_FATAL_FAILURE(twins.Compare()) << scene.substr(0, 90);
    }
  }
}

}  // namespace
}  // namespace robostress
