#pragma once

#include "calib/signature.hpp"
#include "config.hpp"

namespace calib {

/// The key that `config` names, or the one that the service manager passed. An error says where the key should be and
/// what to do, in one line. Fails with `key_not_found`, `key_permissions` or `bad_key`.
[[nodiscard]] Result<SigningKey> load_signing_key(const Config& config);

}  // namespace calib
