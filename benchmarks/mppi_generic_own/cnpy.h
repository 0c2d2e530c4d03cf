/* Stands in for cnpy, by which MPPI-Generic reads weights: here nothing is read. */
#pragma once
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

namespace cnpy {
struct NpyArray {
    std::vector<size_t> shape;
    size_t num_vals = 0;
    size_t num_bytes() const { return 0; }
    template <typename T> T* data() const { throw std::runtime_error("cnpy is not there"); }
};
using npz_t = std::map<std::string, NpyArray>;
inline npz_t npz_load(const std::string&) { throw std::runtime_error("cnpy is not there"); }
inline NpyArray npz_load(const std::string&, const std::string&) { throw std::runtime_error("cnpy is not there"); }
inline NpyArray npy_load(const std::string&) { throw std::runtime_error("cnpy is not there"); }
}  // namespace cnpy
