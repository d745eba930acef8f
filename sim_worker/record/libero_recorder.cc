#include "sim_worker/record/libero_recorder.h"

#include "common/check.h"
#include "common/image.h"

namespace robostress {

LiberoDemonstration ToLibero(const Demonstration& demonstration, const std::string& model_file,
                             bool libero_suite) {
  LiberoDemonstration result;
  result.model_file = model_file;
  LiberoColumns& columns = result.columns;
  columns.steps = static_cast<int64_t>(demonstration.frames.size());
  for (const DemonstrationFrame& frame : demonstration.frames) {
    RS_CHECK(frame.simulator.has_value() && frame.views.size() == 2 && frame.actions.cols() == 7);
    for (int i = 0; i < 7; ++i) columns.actions.push_back(frame.actions(0, i));
    columns.Add(*frame.simulator);
    for (int i = 0; i < 8; ++i) {
      if (!libero_suite) columns.proprioception.push_back(frame.proprioception[i]);
      columns.aux.push_back(frame.aux[i]);
    }
    result.agentview.push_back(libero_suite ? MirrorColumns(frame.views[0]) : frame.views[0]);
    result.eye_in_hand.push_back(libero_suite ? MirrorColumns(frame.views[1]) : frame.views[1]);
  }
  return result;
}

}  // namespace robostress
