#pragma once

#include <string>
#include <vector>

namespace robostress {

// Published numbers (paper.tex, the table of `label`), in percent, for orientation beside ours:
// other policies, other tasks, another protocol. NaN where the paper has none.
struct PublishedGroup {
  std::string title;  // backbone or arm: "pi0.5"
  std::vector<std::string> columns;
  std::vector<std::vector<double>> values;  // [row][column]
};

struct PublishedTable {
  std::string name;   // as in `robostress paper NAME`
  std::string label;  // of the paper: "tab:realistic"
  std::string caption;
  std::string protocol;           // how the paper measured it
  std::vector<std::string> rows;  // scenario names and "average"; else what the row is called
  std::vector<PublishedGroup> groups;

  // The row's index; -1 when the paper has none of this name.
  int RowOf(const std::string& row) const;
};

// main, noise, ablation, anchor, dob, severity, residual, payload, real-arm, unseen.
const std::vector<PublishedTable>& PublishedTables();
// nullptr when unknown.
const PublishedTable* FindPublished(const std::string& name);

// A scenario of tab:residual-magnitude and tab:realistic together, for the report of any run.
struct PaperRow {
  std::string scenario;
  double residual;  // pi0
  double pi0_base, pi0_ours;
  double pi05_base, pi05_ours;
};
const std::vector<PaperRow>& PaperRows();
const PaperRow* FindPaperRow(const std::string& scenario);
// Over the seven scenarios; the residual's is ours, of the published rows.
const PaperRow& PaperAverage();

}  // namespace robostress
