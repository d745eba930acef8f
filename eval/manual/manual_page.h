#pragma once

#include <string>
#include <vector>

#include "eval/manual/option_tables.h"

namespace robostress {

// The page of section 1 in roff's man macros, in ASCII. `others`: names of pages to see also.
std::string ManualPage(const CommandTable& table, const std::vector<std::string>& others);

}  // namespace robostress
