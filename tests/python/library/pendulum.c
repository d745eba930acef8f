/* A program of C alone: a joint with a mass, held by a controller, with backlash in its transmission. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "robostress.h"

static int failed(const char* what, const char* message) {
  fprintf(stderr, "%s: %s\n", what, message);
  return 1;
}

int main(void) {
  char error[256] = "";
  robostress_errors* errors = NULL;
  const double half_width[1] = {0.01}; /* [rad] */
  double q = 0, dq = 0, largest = 0;
  int i;

  if (robostress_interface() < ROBOSTRESS_INTERFACE) return failed("library", "too old");
  if (robostress_errors_new("no_such_scenario", 7, NULL, &errors, error, sizeof error) != ROBOSTRESS_NOT_FOUND ||
      strstr(error, "heavy_payload") == NULL)
    return failed("an unknown scenario", error);
  if (robostress_errors_new("clean", 1, NULL, &errors, error, sizeof error) != ROBOSTRESS_OK ||
      robostress_errors_add_effect(errors, 0, "backlash", half_width, 1, -1, error, sizeof error) != ROBOSTRESS_OK)
    return failed("new", error);

  for (i = 0; i <= 1000; ++i) {
    const double inertia = 0.1, step = 0.002, limit[2] = {-5, 5};
    double asked = 20 * (sin(0.004 * i) - q) - 2 * dq, applied, change;
    robostress_moment moment;
    memset(&moment, 0, sizeof moment);
    moment.size = sizeof moment;
    moment.time = step * i;
    moment.step = step;
    moment.q = &q;
    moment.dq = &dq;
    moment.torque_low = &limit[0];
    moment.torque_high = &limit[1];
    if (i == 0) {
      if (robostress_errors_reset(errors, &moment, NULL, error, sizeof error) != ROBOSTRESS_OK)
        return failed("reset", error);
      continue;
    }
    if (i % 25 == 1) robostress_errors_begin_control_step(errors, i / 25, 0);
    if (robostress_errors_torque(errors, &moment, &asked, &applied, error, sizeof error) != ROBOSTRESS_OK ||
        robostress_errors_offset_change(errors, &applied, &change, error, sizeof error) != ROBOSTRESS_OK)
      return failed("sub-step", error);
    dq += step * applied / inertia;
    q += step * dq + change;
    robostress_errors_offset(errors, &change);
    if (fabs(change) > largest) largest = fabs(change);
  }
  robostress_errors_free(errors);
  printf("robostress %s: the link was off its motor by at most %.4f rad\n", robostress_version(), largest);
  return fabs(largest - half_width[0]) < 1e-9 ? 0 : failed("backlash", "not felt");
}
