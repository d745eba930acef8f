#pragma once

#include <mujoco/mujoco.h>

namespace robostress::libero {

// MuJoCo's collision of two boxes (2.2.2, and later ones: google-deepmind/mujoco issue 3476) can
// report, beside the right contacts of boxes that lie flat on each other, one that is as deep as
// the larger box is wide; the solver throws the object away. From the first call on, in the whole
// process, a contact of two boxes that is deeper along its normal than their shadows on it overlap
// is left out: no such contact can be. All others are MuJoCo's, to the bit.
void LeaveOutImpossibleBoxContacts();

// How many of `contacts` [count] of the boxes g1 and g2 are possible; these come first, in their
// order.
int KeepPossible(const mjModel& model, const mjData& data, int g1, int g2, mjContact* contacts,
                 int count);

}  // namespace robostress::libero
