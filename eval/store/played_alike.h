#pragma once

#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "common/unit_config.h"
#include "eval/store/run_store.h"

namespace robostress {

// A configuration as flat keys: "sim.stepping" -> "fast". What is empty is left out, and a younger
// key (config.h, Late) at its default.
using FlatOptions = std::map<std::string, std::string>;
FlatOptions FlatOptionsOf(const std::string& yaml);
// "sim.controller_kp is 300 in A, and its default in B": the first key whose values differ; empty
// where none does.
std::string FirstDifference(const FlatOptions& a, const std::string& in_a, const FlatOptions& b,
                            const std::string& in_b);

// Whether a unit is played in LIBERO's tasks, in a task folder or with a table of fixtures, whose
// content a name does not tell.
bool NamesFiles(const UnitConfig& config);
// A unit's configuration whose task folder and table of fixtures stand by the hash of what was in
// them when it was played, where its provenance.json has that: they may have changed since.
UnitConfig WithPlayedFiles(UnitConfig config, const nlohmann::json& provenance);
// The same by what is in them now; each is read once.
class PresentFiles {
 public:
  UnitConfig Of(UnitConfig config);

 private:
  std::map<std::string, std::string> known_;
};

// What decides an outcome of the unit beside scenario, severity, policy, method and seed. A path
// stands by its file's hash.
FlatOptions ProtocolOf(const UnitConfig& unit);
// What distinguishes the scenario, whatever it is called; empty: it is an arm of the program, or
// its file is gone.
std::string ScenarioHash(const UnitConfig& config);

// Rates stand beside each other, and episodes pair, only where units agree in what their names do
// not say: those of a suite in the protocol, whichever episodes they have, those of a method in its
// options, those of a policy in how its server is asked, those of a scenario file in what it holds.
class PlayedAlike {
 public:
  // Compares with those added before, and adds. `place` names the unit in complaints.
  void Add(const UnitConfig& config, const std::string& place);
  // Compares alone.
  void Compare(const UnitConfig& config, const std::string& place);
  // One for each suite, method, policy and scenario file, with key and both values.
  const std::vector<std::string>& complaints() const { return complaints_; }

 private:
  struct First {
    UnitConfig config;
    std::string place;
  };
  void Look(const UnitConfig& config, const std::string& place, bool add);
  std::map<std::string, First> first_;  // of a suite, method, policy or scenario file
  std::set<std::string> seen_, unlike_;
  std::vector<std::string> complaints_;
};

std::vector<std::string> UnlikeUnits(const RunData& run);
// "" where there are none; else what a table must say.
std::string UnlikeUnitsNote(const RunData& run);
// The same of units that read other files of LIBERO's than the published ones.
std::string LiberoFilesNote(const RunData& run);

}  // namespace robostress
