#pragma once

#include <chrono>
#include <string_view>

namespace calib::ctl {

/// Redraws a text in place on the terminal at standard output: on the alternate screen, line over line and without
/// clearing, so that nothing flickers over a slow connection. The terminal is as it was before when this is destroyed.
class Screen {
 public:
  /// Whether standard output is a terminal that can do that.
  [[nodiscard]] static bool is_available();

  Screen();
  ~Screen();
  Screen(const Screen&) = delete;
  Screen& operator=(const Screen&) = delete;

  /// Shows as many lines as the terminal has; longer lines are cut at its edge. False: it cannot be written to.
  [[nodiscard]] bool show(std::string_view text);
  /// Until the next redrawing is due: `pause` has passed, the size of the terminal has changed, or the program was
  /// stopped and continued. False: it was asked to end (SIGINT, SIGTERM, SIGHUP).
  [[nodiscard]] bool wait(std::chrono::seconds pause);

 private:
  void enter();
  void leave();
};

}  // namespace calib::ctl
