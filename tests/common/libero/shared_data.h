#pragma once

#include <gtest/gtest.h>

#include <string>

namespace robostress::libero {

// The folder of shared data: $ROBOSTRESS_SHARED, else ../shared beside the repository; empty when
// absent.
std::string SharedFolder();
std::string LiberoTree();     // SharedFolder()/data/libero_tree
std::string RobosuiteTree();  // SharedFolder()/data/robosuite_tree

}  // namespace robostress::libero

// Skips the test, with the reason printed, when the shared data is not there.
#define SKIP_WITHOUT_SHARED_DATA()                                                               \
  if (::robostress::libero::SharedFolder().empty()) {                                            \
    GTEST_SKIP() << "no LIBERO files: set ROBOSTRESS_SHARED to a folder with data/libero_tree, " \
                    "data/robosuite_tree and oracles/libero";                                    \
  }
