#pragma once

#include <string>
#include <vector>

namespace robostress {

// Where a quantity of a rig's model comes from.
enum class FactSource {
  kRead,      // the model's file says it
  kRig,       // the rig file says it, or fits it
  kAssumed,   // nobody says it
  kRepaired,  // the file says what no body can have
  kLeftOut,   // the file says it, and nothing here uses it
};
const char* FactSourceName(FactSource source);

// One line of the table of what a model says and what was assumed.
struct ModelFact {
  std::string part;   // a joint or a link; "model": of the whole
  std::string what;   // "damping"
  std::string value;  // with its unit
  FactSource source = FactSource::kRead;
  std::string remedy;  // what to do where it is wrong; empty: nothing can be said
};

// The line of joints that the rig does not list, which stand still.
ModelFact HeldFact(std::vector<std::string> joints);

// For people: a line per part, then what to do where an assumption is wrong. Every line begins with
// `indent` and ends with a line break.
std::string ModelTableText(const std::vector<ModelFact>& facts, const std::string& indent);

}  // namespace robostress
