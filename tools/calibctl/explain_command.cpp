#include <algorithm>
#include <cctype>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string_view>

#include "code_pages.hpp"
#include "commands.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

constexpr std::string_view cause = "cause: ", example = "example: ", remedy = "remedy: ";

/// What follows `key` at the beginning of a line of `page`.
std::string value_of(std::string_view page, std::string_view key) {
  const std::size_t at = page.find('\n' + std::string(key));
  if (at == std::string_view::npos) return {};
  const std::string_view rest = page.substr(at + 1 + key.size());
  return std::string(rest.substr(0, rest.find('\n')));
}

/// The part of codes.txt about `code`; empty for a code that it does not have.
std::string_view page_of(std::string_view code) {
  const std::string heading = "\n[" + std::string(code) + "]\n";
  const std::size_t at = code_pages.find(heading);
  if (at == std::string_view::npos) return {};
  const std::string_view rest = code_pages.substr(at + heading.size() - 1);
  return rest.substr(0, rest.find("\n\n"));
}

/// Codes that have `part` in their name, as a help for those who remember half of it.
std::vector<std::string> codes_with(std::string_view part) {
  std::vector<std::string> codes;
  for (std::size_t at = code_pages.find("\n["); at != std::string_view::npos; at = code_pages.find("\n[", at + 1)) {
    const std::string_view name = code_pages.substr(at + 2, code_pages.find(']', at) - at - 2);
    if (name.find(part) != std::string_view::npos) codes.emplace_back(name);
  }
  return codes;
}

std::string codes_like(std::string_view part) {
  std::string list;
  for (const std::string& code : codes_with(part)) list += (list.empty() ? "" : ", ") + code;
  return list;
}

/// Escapes what scdoc takes for markup.
std::string plain(std::string_view words) {
  std::string escaped;
  for (const char c : words) {
    if (std::string_view("\\*_[#~<+").find(c) != std::string_view::npos) escaped += '\\';
    escaped += c;
  }
  return escaped;
}

/// A sentence of `words`.
std::string sentence(std::string_view words) {
  std::string text = plain(words) + ".";
  text[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(text[0])));
  return text;
}

/// Prints the manual page, for scdoc.
void print_page() {
  std::cout << "calibd-codes(7)\n\n# NAME\n\ncalibd-codes - what each code of calibd and its tools means, and what to "
               "do\n\n# DESCRIPTION\n\nCodes stand in the status, in records and alerts, in the answers of *calibctl "
               "doctor* and in the results of\n*calib-eval*. They do not change from version to version. *calibctl "
               "explain* _CODE_ prints what stands here.\n";
  for (std::size_t at = 0; at < code_pages.size();) {
    const std::size_t end = std::min(code_pages.find('\n', at), code_pages.size());
    const std::string_view line = code_pages.substr(at, end - at);
    at = end + 1;
    if (line.starts_with("== "))
      std::cout << "\n# " << line.substr(3, line.find(':') - 3) << "\n\n"
                << sentence(line.substr(line.find(':') + 2)) << '\n';
    else if (line.starts_with('['))
      std::cout << "\n*" << plain(line.substr(1, line.size() - 2)) << "*\n";
    else if (line.starts_with(cause))
      std::cout << "\tCause: " << sentence(line.substr(cause.size())) << "\n\n";
    else if (line.starts_with(example))
      std::cout << "\tExample: " << plain(line.substr(example.size())) << "\n\n";
    else if (line.starts_with(remedy))
      std::cout << "\tRemedy: " << sentence(line.substr(remedy.size())) << '\n';
  }
  std::cout << "\n# SEE ALSO\n\n*calibd-messages*(5), *calibctl*(1), *calib-eval*(1), *calibd*(8)\n";
}

}  // namespace

Exit explain(const ExplainOptions& options) {
  if (options.page) {
    print_page();
    return Exit::done;
  }
  Text text(/*coloured=*/false);
  if (options.code.empty() && options.json) {
    std::cout << json_text({{"schema", 1}, {"codes", codes_with("")}}, 2);
    return Exit::done;
  }
  if (options.code.empty()) {
    text.wrapped("Codes", codes_like(""));
    std::cout << text.str();
    return Exit::done;
  }
  const std::string_view page = page_of(options.code);
  if (page.empty()) {
    const std::string like = options.code.size() < 3 ? "" : codes_like(options.code);
    return print_error({ErrorCode::not_found, "there is no code '" + options.code + "'; " +
                                                  (like.empty() ? "calibctl explain lists all" : "there is " + like)});
  }
  if (options.json) {
    std::cout << json_text({{"schema", 1},
                            {"code", options.code},
                            {"cause", value_of(page, cause)},
                            {"example", value_of(page, example)},
                            {"remedy", value_of(page, remedy)}},
                           2);
    return Exit::done;
  }
  text.line("Code", options.code);
  text.wrapped("Cause", value_of(page, cause));
  text.wrapped("Example", value_of(page, example));
  text.wrapped("Remedy", value_of(page, remedy));
  std::cout << text.str();
  return Exit::done;
}

}  // namespace calib::ctl
