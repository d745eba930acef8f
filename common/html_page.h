#pragma once

#include <string>

namespace robostress {

// Doctype, title and style, `<body>` included: what every page of this repository begins with. The
// page needs nothing else; it prints in black on white and follows the reader's choice of light or
// dark, plots of common/svg_plot.h included.
std::string PageHead(const std::string& title);

}  // namespace robostress
