#include "eval/store/served_policies.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/json_text.h"
#include "eval/plan/plan.h"

namespace robostress {
namespace {

constexpr size_t kDigits = 12;  // of a hash, in a sentence

void AddServers(const UnitResult& unit, ServedPolicy& policy) {
  std::set<std::string> urls, metadata;
  for (const ServerRow& row : unit.servers) {
    urls.insert(row.url);
    metadata.insert(row.metadata_sha256);
    policy.reconnections += row.reconnections;
  }
  if (const std::string said = TextAt(unit.provenance, "metadata"); !said.empty())
    metadata.insert(Sha256Hex(said));
  // Units of 0.2 and before knew the first address alone.
  if (const std::string url = TextAt(unit.provenance, "url"); urls.empty() && !url.empty())
    urls.insert(url.substr(0, url.find('?')));
  for (const std::string& url : urls) ++policy.urls[url];
  if (metadata.size() > 1) policy.changed.push_back(unit.id);
  policy.metadata_sha256.merge(metadata);
}

}  // namespace

std::vector<ServedPolicy> ServedPolicies(const RunData& run) {
  std::map<std::string, ServedPolicy> policies;
  for (const UnitResult& unit : run.units) {
    if (!unit.config.remote.used()) continue;
    ServedPolicy& policy = policies[PolicyLabel(unit.config.policy)];
    policy.label = PolicyLabel(unit.config.policy);
    policy.dialect = unit.config.remote.dialect.name;
    policy.noise_paired = policy.noise_paired && PairsNoise(unit);
    ++policy.units;
    AddServers(unit, policy);
  }
  std::vector<ServedPolicy> all;
  for (auto& [label, policy] : policies) all.push_back(std::move(policy));
  return all;
}

std::vector<std::string> ServerNotes(const RunData& run) {
  std::vector<std::string> notes;
  for (const ServedPolicy& policy : ServedPolicies(run)) {
    if (!policy.changed.empty()) {
      notes.push_back(
          absl::StrCat("The server of ", policy.label, " changed its metadata while ",
                       policy.changed.size(), policy.changed.size() == 1 ? " unit" : " units",
                       " ran, so that their rows may be of two models; remove and run again: ",
                       absl::StrJoin(policy.changed, ", "), "."));
    }
    std::vector<std::string> urls, hashes;
    for (const auto& [url, units] : policy.urls)
      urls.push_back(absl::StrCat(url, " (", units, ")"));
    for (const std::string& hash : policy.metadata_sha256)
      hashes.push_back(hash.substr(0, kDigits));
    notes.push_back(absl::StrCat(
        "Policy ", policy.label, ", a label that the user gave, was served by (units) ",
        urls.empty() ? "an address that was not recorded" : absl::StrJoin(urls, ", "),
        "; metadata ", hashes.empty() ? "not recorded" : absl::StrJoin(hashes, ", "), "; ",
        policy.reconnections, policy.reconnections == 1 ? " reconnection." : " reconnections."));
  }
  return notes;
}

}  // namespace robostress
