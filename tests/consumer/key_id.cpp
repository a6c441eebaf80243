// Links the library of records alone, without the estimator.
#include <calib/signature.hpp>
#include <cstdio>

int main() { std::printf("key %s\n", calib::SigningKey::generate().public_key().id_text().c_str()); }
