// What the peers in C++ share of the protocol of protocol.py: the hints, which points are taken, and how a pose is timed and
// printed.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

/// What is told besides the scan, mm.
struct Hints {
  double radius, radius_min, radius_max, noise, pitch;
};

/// A point of the axis, its direction and the radius, mm.
struct Pose {
  double point[3], direction[3], radius;
};

inline double number_in(const std::string& text, const std::string& name) {
  const auto at = text.find('"' + name + '"');
  if (at == std::string::npos) throw std::runtime_error("no " + name + " among the hints");
  return std::stod(text.substr(text.find(':', at) + 1));
}

inline Hints read_hints(const char* path) {
  std::ifstream file(path);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  const auto told = [&](const char* name) { return number_in(text, name); };
  return {told("radius"), told("radius_min"), told("radius_max"), told("noise"), told("pitch")};
}

inline bool prime(std::size_t number) {
  for (std::size_t i = 2; i * i <= number; ++i)
    if (number % i == 0) return false;
  return true;
}

/// The step that leaves so many points or a few less: a prime, which is never in step with the points of a profile.
inline std::size_t step_for(std::size_t all, std::size_t count) {
  std::size_t step = std::max<std::size_t>(1, all / count);
  while (!prime(step)) ++step;
  return step;
}

inline void print(const std::optional<Pose>& found, const std::vector<double>& seconds) {
  if (found) {
    const auto& [x, y, z] = found->point;
    const auto& [u, v, w] = found->direction;
    const double p = v / u, q = w / u;
    std::printf("{\"p\": %.12g, \"q\": %.12g, \"y0\": %.12g, \"z0\": %.12g", p, q, y - p * x, z - q * x);
    std::printf(", \"radius\": %.12g, \"point\": [%.12g, %.12g, %.12g]", found->radius, x, y, z);
    std::printf(", \"direction\": [%.12g, %.12g, %.12g]", u, v, w);
  } else {
    std::printf("{\"refused\": \"no cylinder found\"");
  }
  std::printf(", \"seconds\": [");
  for (std::size_t i = 0; i < seconds.size(); ++i) std::printf("%s%.9g", i ? ", " : "", seconds[i]);
  std::printf("]}\n");
}

/// Estimates so many times and prints the last pose with all times.
template <typename Estimate>
void time_and_print(int repeats, const Estimate& estimate) {
  std::optional<Pose> found;
  std::vector<double> seconds;
  for (int i = 0; i < repeats; ++i) {
    const auto start = std::chrono::steady_clock::now();
    found = estimate();
    seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  print(found, seconds);
}
