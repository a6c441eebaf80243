#include "build_id.hpp"

#include <link.h>

#include <algorithm>
#include <cstring>
#include <string_view>

namespace calib {
namespace {

constexpr std::string_view hex_digits = "0123456789abcdef";

/// The description of the GNU build id among `notes`, each a header, a name and a description, both of which end padded
/// to `alignment` bytes from the note's begin; empty when it is not there.
std::string_view find_build_id(std::string_view notes, std::size_t alignment) {
  const auto padded = [alignment](std::size_t size) { return (size + alignment - 1) / alignment * alignment; };
  ElfW(Nhdr) note;
  while (notes.size() >= sizeof note) {
    std::memcpy(&note, notes.data(), sizeof note);
    const std::size_t description_at = padded(sizeof note + note.n_namesz);
    if (description_at > notes.size() || note.n_descsz > notes.size() - description_at) break;
    if (note.n_type == NT_GNU_BUILD_ID && notes.substr(sizeof note, note.n_namesz) == std::string_view("GNU\0", 4))
      return notes.substr(description_at, note.n_descsz);
    notes.remove_prefix(std::min(notes.size(), padded(description_at + note.n_descsz)));
  }
  return {};
}

/// Called for each loaded object, the program first; any answer but 0 ends the walk.
int look_at_program(dl_phdr_info* object, std::size_t, void* found) {
  for (ElfW(Half) i = 0; i < object->dlpi_phnum; ++i) {
    const ElfW(Phdr)& segment = object->dlpi_phdr[i];
    if (segment.p_type != PT_NOTE) continue;
    const auto* begin = reinterpret_cast<const char*>(object->dlpi_addr + segment.p_vaddr);
    const auto id = find_build_id({begin, segment.p_memsz}, segment.p_align == 8 ? 8 : 4);
    if (!id.empty()) *static_cast<std::string_view*>(found) = id;
  }
  return 1;
}

}  // namespace

Result<std::string> build_id() {
  std::string_view id;
  dl_iterate_phdr(look_at_program, &id);
  if (id.empty())
    return fail(ErrorCode::no_build_id, "this program was linked without a build id; link it with -Wl,--build-id=sha1");
  std::string hex;
  for (const char byte : id) {
    const auto value = static_cast<unsigned char>(byte);
    hex += {hex_digits[value >> 4], hex_digits[value & 15]};
  }
  return hex;
}

}  // namespace calib
