#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

// The table of methods, and how their options are read. All of it refuses what is not known and
// what would change nothing: an option of a way that the method does not have, unless the same text
// says that the way is off, as every resolved configuration does.
namespace YAML {
class Node;
}

namespace robostress {

struct MethodOptions;  // adapter/method_options.h

// Names in the order of the tables.
std::vector<std::string> MethodNames();
// How tables and plots call and draw a method ("Ours, model following", "#dc2626"); of a name that
// is none, the name itself and grey.
std::string MethodTitle(const std::string& name);
std::string MethodColor(const std::string& name);

// A preset with "key=value" overrides applied, all at once: NOT_FOUND lists the known methods. The
// preset's name itself is no override: INVALID_ARGUMENT.
absl::StatusOr<MethodOptions> MakeMethod(const std::string& name,
                                         const std::vector<std::string>& overrides = {});
// The overrides over what `options` has.
absl::Status OverrideMethod(const std::vector<std::string>& overrides, MethodOptions& options);
// MakeMethod(name, ...) with overrides that are meant for several methods: those for a way that
// others of `methods` have and this one does not are left out.
absl::StatusOr<MethodOptions> MakeMethodOf(const std::vector<std::string>& methods,
                                           const std::string& name,
                                           const std::vector<std::string>& overrides);

// A method as YAML text: the preset that its key `method` names, and over it every other key that
// is given. So "method: ours" adapts, and a dump of all options reads back to the same bits.
// INVALID_ARGUMENT names `source` and lists what is known: no map, no or an unknown `method`, an
// unknown key, a value of the wrong type.
absl::StatusOr<MethodOptions> ParseMethod(const std::string& source, const std::string& yaml);
absl::StatusOr<MethodOptions> ReadMethod(const std::string& source, const YAML::Node& given);

}  // namespace robostress
