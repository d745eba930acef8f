#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace robostress::libero {

// A zip file of one entry, written as torch.save writes it. Method 0 is stored, 8 deflated; others
// are stored and say so.
std::string Zip(const std::string& name, const std::string& data, uint16_t method = 0);

// BINUNICODE of a pickle.
std::string Unicode(const std::string& utf8);

// NumPy's pickle (protocol 2) of a float64 matrix [rows, columns], as LIBERO's files hold it.
std::string Pickle(const std::vector<double>& values, int rows, int columns);

// A file of so many initial states, each of one number.
std::string InitFile(int rows);
// The text of the smallest BDDL file that can be read.
std::string TaskFile(const std::string& problem);

// NumPy's .npy of a float64 matrix, version 1, with this text for its shape.
std::string Npy(const std::vector<double>& values, const std::string& shape,
                const std::string& order = "False", const std::string& type = "<f8");

}  // namespace robostress::libero
