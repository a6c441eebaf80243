#pragma once

#include <string>
#include <vector>

#include "doctor.hpp"

namespace calib {

/// What `calibctl doctor` shows.
struct DiagnosisReport {
  struct PairFinding {
    std::string pair;
    Finding finding;
  };
  struct Overlay {
    std::string pair, file;
  };
  std::vector<PairFinding> checks;
  std::vector<Overlay> overlays;
};

}  // namespace calib
