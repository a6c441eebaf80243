#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "commands.hpp"

namespace calib::ctl {

/// Replaces this process by calib-check-model, beside this program or else in PATH: calibctl links no estimator, and a
/// network is checked by the functions of the estimator that calibd runs it with.
Exit check_model(const std::vector<std::string>& arguments) {
  std::string name = "calib-check-model";
  std::vector<char*> words{name.data()};
  std::vector<std::string> copies = arguments;
  for (std::string& argument : copies) words.push_back(argument.data());
  words.push_back(nullptr);
  std::error_code ignored;
  const std::filesystem::path beside = std::filesystem::read_symlink("/proc/self/exe", ignored).replace_filename(name);
  ::execv(beside.c_str(), words.data());
  if (errno == ENOENT) ::execvp(name.c_str(), words.data());
  if (errno == ENOENT)
    return print_error({ErrorCode::not_found,
                        "there is no calib-check-model beside calibctl or in PATH; it is in the package calibd-tools"});
  return print_error({ErrorCode::failed, std::string("calib-check-model cannot be run: ") + std::strerror(errno)});
}

}  // namespace calib::ctl
