#pragma once

#include <string>
#include <vector>

#include "eval/paper/filled_table.h"
#include "eval/paper/paper_table.h"
#include "eval/report/paper_values.h"
#include "eval/store/run_store.h"

namespace robostress {

// The finished units of `run` that are among `planned`; the others, and what the plan misses, do
// not enter a table.
RunData UnitsOf(const RunData& run, const std::vector<PlannedUnit>& planned);

// The table with our numbers: per scenario Wilson's interval, averages and residuals with the
// cluster bootstrap, contrasts on the same episodes with sign-flip p values and Holm's correction
// over the table's scenarios. `run` holds the table's units only. Units of a cell that are not
// finished are named in the notes; their cells hold what there is.
FilledTable FillPaperTable(const PaperTable& table, const PaperProtocol& protocol,
                           const RunData& run, const std::vector<PlannedUnit>& planned,
                           int bootstrap_replicates);

// Appends the paper's groups to a table whose rows are `rows` of the published table, in its order.
void AddPublished(const PublishedTable& published, const std::vector<std::string>& rows,
                  FilledTable& table);

}  // namespace robostress
