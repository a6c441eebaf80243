#include "calib/chain.hpp"

#include <cstdlib>

#include "support/catch.hpp"
#include "support/records.hpp"

using namespace calib;
using namespace calib::test;
using Catch::Matchers::ContainsSubstring;

namespace {

using Chain = std::vector<SignedRecord>;

RecordOf reader(const Chain& chain) {
  return [&chain](std::uint64_t sequence) -> Result<SignedRecord> {
    if (sequence == 0 || sequence > chain.size()) return fail(ErrorCode::record_not_found, "none");
    return chain[sequence - 1];
  };
}

struct Verified {
  std::uint64_t records = 0;
  Result<std::vector<KeyPeriod>> periods;
};

Verified verify(const Chain& chain, const PublicKey& trusted) {
  Verified verified;
  verified.periods = visit_verified(chain.size(), reader(chain), trusted,
                                    [&](const CalibrationRecord&, const SignedRecord&) { ++verified.records; });
  return verified;
}

/// The chain with the last record of it replaced by what does not verify.
void check_broken(const Chain& chain, const PublicKey& trusted, std::size_t good, const std::string& words) {
  const Verified verified = verify(chain, trusted);
  CHECK(verified.records == good);
  REQUIRE_FALSE(verified.periods);
  CHECK_THAT(verified.periods.error().context, ContainsSubstring(words));
  CHECK_THAT(verified.periods.error().context, ContainsSubstring("record " + std::to_string(good + 1)));
}

/// Where the chain breaks; its length when it does not.
std::size_t verified_length(const std::vector<SignedRecord>& chain, const PublicKey& key) {
  std::string previous(no_previous_sha256);
  for (std::size_t i = 0; i < chain.size(); ++i) {
    if (!verify_record(chain[i], key, previous, i + 1)) return i;
    previous = sha256_hex(chain[i].canonical);
  }
  return chain.size();
}

CalibrationRecord key_change(const Chain& chain, KeyChange change) {
  CalibrationRecord record;
  record.vehicle = "car";
  record.sequence = chain.size() + 1;
  record.previous_sha256 = chain.empty() ? std::string(no_previous_sha256) : sha256_hex(chain.back().canonical);
  record.decision = Decision::key_changed;
  record.reason = "another key";
  record.asked_by = "uid:0";
  record.configuration_sha256 = sha256_hex("configuration");
  record.software_version = "1.2.3";
  record.software_sha256 = sha256_hex("software");
  record.boot_id = "boot";
  record.key_change = change;
  return record;
}

struct Keys {
  std::mt19937 random{1};
  SigningKey first = SigningKey::generate(), second = SigningKey::generate(), third = SigningKey::generate();

  void add(Chain& chain, std::size_t count, const SigningKey& key) {
    while (count-- > 0) chain.push_back(sign_next(random_record(random), chain, key));
  }
  static void change(Chain& chain, const SigningKey& from, const SigningKey& to, bool lost = false,
                     std::optional<std::uint64_t> doubted_from = {}) {
    const auto record = key_change(chain, {from.public_key(), to.public_key(), lost, doubted_from});
    chain.push_back(require_ok(sign_key_change(record, lost ? nullptr : &from, to)));
  }
  /// Records 1 and 2 of the first key, 3 changes to the second, 4 and 5 of that, 6 changes to the third, 7 of that.
  Chain twice_changed() {
    Chain chain;
    add(chain, 2, first);
    change(chain, first, second);
    add(chain, 2, second);
    change(chain, second, third);
    add(chain, 1, third);
    return chain;
  }
};

}  // namespace

TEST_CASE("a chain verifies across changes of keys, from any of its keys") {
  Keys keys;
  const Chain chain = keys.twice_changed();
  for (const SigningKey* trusted : {&keys.first, &keys.second, &keys.third}) {
    const Verified verified = verify(chain, trusted->public_key());
    const auto periods = require_ok(verified.periods);
    CHECK(verified.records == 7);
    REQUIRE(periods.size() == 3);
    CHECK((periods[0].key == keys.first.public_key() && periods[0].from == 1 && periods[0].until == 3));
    CHECK((periods[1].key == keys.second.public_key() && periods[1].from == 4 && periods[1].until == 6));
    CHECK((periods[2].key == keys.third.public_key() && periods[2].from == 7 && !periods[2].until));
    CHECK(period_of(3, periods).key == keys.first.public_key());
    CHECK(period_of(4, periods).key == keys.second.public_key());
  }
  const auto other = verify(chain, SigningKey::generate().public_key());
  CHECK(other.records == 0);
  CHECK(other.periods.error().code == "wrong_key");
}

TEST_CASE("minisign's format of a change of keys is two signature files of one text") {
  Keys keys;
  Chain chain;
  Keys::change(chain, keys.first, keys.second);
  const auto [first, second] = split_signatures(chain[0].signature);
  CHECK(verify_signature(chain[0].canonical, first, keys.first.public_key()));
  CHECK(verify_signature(chain[0].canonical, second, keys.second.public_key()));
  CHECK_THAT(chain[0].canonical,
             ContainsSubstring(R"("key_change":{"doubted_from":null,"next":")" + keys.second.public_key().text()));
  CHECK(split_signatures("").first.empty());
  CHECK(split_signatures("one line").first == "one line");
  CHECK(split_signatures("1\n2\n3\n4").second.empty());
  CHECK(split_signatures("1\n2\n3\n4\n5").second == "5");
}

TEST_CASE("a change of keys needs both keys, and nobody else's") {
  Keys keys;
  Chain chain;
  keys.add(chain, 2, keys.first);
  const PublicKey first = keys.first.public_key(), second = keys.second.public_key();
  const auto with = [&](const CalibrationRecord& record, const SigningKey* previous, const SigningKey& next) {
    Chain longer = chain;
    longer.push_back(require_ok(sign_key_change(record, previous, next)));
    return longer;
  };
  const CalibrationRecord record = key_change(chain, {first, second, false, {}});
  CHECK(verify(with(record, &keys.first, keys.second), first).periods);
  check_broken(with(record, nullptr, keys.first), first, 2, "only one key has signed it");
  check_broken(with(record, nullptr, keys.second), first, 2, "signed by key " + second.id_text());
  check_broken(with(record, &keys.first, keys.third), first, 2, "it names another key, which has not signed it");
  check_broken(with(record, &keys.third, keys.second), first, 2, "signed by key " + keys.third.public_key().id_text());
  check_broken(with(record, &keys.first, keys.first), first, 2, "it names another key, which has not signed it");
  // A thief's key in the place of the one before.
  check_broken(with(key_change(chain, {keys.third.public_key(), second, false, {}}), &keys.first, keys.second), first,
               2, "it replaces key " + keys.third.public_key().id_text());
  // The second signature of another record, or one too many.
  Chain other = with(record, &keys.first, keys.second);
  other[2].signature = std::string(split_signatures(other[2].signature).first) +
                       std::string(split_signatures(keys.twice_changed()[2].signature).second);
  CHECK_FALSE(verify(other, first).periods);
  Chain two = chain;
  two[1].signature += two[1].signature;
  check_broken(two, first, 1, "it has other signatures than what it says needs");
}

TEST_CASE("a key that was replaced signs nothing any more, and does not come back") {
  Keys keys;
  Chain chain = keys.twice_changed();
  Chain late = chain;
  keys.add(late, 1, keys.second);
  check_broken(late, keys.first.public_key(), 7,
               "it is signed with key " + keys.second.public_key().id_text() +
                   ", which record 6 has replaced with key " + keys.third.public_key().id_text());
  Chain back = chain;
  Keys::change(back, keys.third, keys.first);
  check_broken(back, keys.first.public_key(), 7, "which was replaced before");
  // Who has stolen the first key writes another history from there; whoever trusts a later key does not believe it.
  Chain stolen(chain.begin(), chain.begin() + 2);
  keys.add(stolen, 3, keys.first);
  CHECK(verify(stolen, keys.first.public_key()).periods);
  CHECK(verify(stolen, keys.third.public_key()).periods.error().code == "wrong_key");
}

TEST_CASE("a lost key is believed to be lost by who trusts the next one, and by nobody else") {
  Keys keys;
  Chain chain;
  keys.add(chain, 2, keys.first);
  Keys::change(chain, keys.first, keys.second, /*lost=*/true, 2);
  keys.add(chain, 1, keys.second);
  Keys::change(chain, keys.second, keys.third);
  for (const SigningKey* trusted : {&keys.second, &keys.third}) {
    const auto periods = require_ok(verify(chain, trusted->public_key()).periods);
    REQUIRE(periods.size() == 3);
    CHECK(periods[0].doubts(2));
    CHECK_FALSE((periods[0].doubts(1) || periods[0].doubts(3) || periods[1].doubts(4)));
  }
  check_broken(chain, keys.first.public_key(), 2,
               "key " + keys.first.public_key().id_text() + " was lost, and is signed with key " +
                   keys.second.public_key().id_text() + " alone");
  // The records before it are bound to it by their hashes.
  Chain forged = chain;
  forged[0] = sign_next(random_record(keys.random), {}, keys.first);
  CHECK(verify(forged, keys.third.public_key()).records == 1);
}

TEST_CASE("only records of the key that is replaced can be doubted") {
  Keys keys;
  for (const std::uint64_t from : {0, 3, 7, 99}) {
    Chain chain = keys.twice_changed();
    chain.resize(5);
    Keys::change(chain, keys.second, keys.third, false, from);
    check_broken(chain, keys.first.public_key(), 5, "it doubts records that the key before it has not signed");
  }
}

TEST_CASE("a text that is not a change of keys is refused") {
  Keys keys;
  const std::string good =
      canonical_bytes(key_change({}, {keys.first.public_key(), keys.second.public_key(), false, 1}));
  REQUIRE(parse_record(good));
  const std::string first = keys.first.public_key().text(), second = keys.second.public_key().text();
  const auto replaced = [&](const std::string& what, const std::string& with) {
    std::string text = good;
    REQUIRE(text.find(what) != std::string::npos);
    return text.replace(text.find(what), what.size(), with);
  };
  for (const std::string& bad :
       {replaced(R"("schema":3)", R"("schema":2)"), replaced(first, second), replaced(second, "RWQ="),
        replaced(R"("previous_lost":false)", R"("previous_lost":0)"), replaced(R"(,"previous_lost":false)", ""),
        replaced(R"("doubted_from":1)", R"("doubted_from":-1)"),
        replaced(R"("doubted_from":1)", R"("doubted_from":1,"q":1)"), replaced(R"("login":null)", R"("login":"")"),
        replaced(R"("login":null,)", ""), replaced(R"("comment":null)", R"("comment":"a\nb")"),
        replaced(R"("key_changed")", R"("accepted")")}) {
    INFO(bad);
    CHECK_FALSE(parse_record(bad));
  }
}

TEST_CASE("a chain breaks where a record is removed, moved, replaced or inserted") {
  std::mt19937 random(4);
  const SigningKey key = SigningKey::generate();
  const PublicKey public_key = key.public_key();
  const auto chain = random_chain(random, 6, key);
  REQUIRE(verified_length(chain, public_key) == 6);

  for (std::size_t i = 0; i + 1 < chain.size(); ++i) {
    auto removed = chain;
    removed.erase(removed.begin() + static_cast<std::ptrdiff_t>(i));
    CHECK(verified_length(removed, public_key) == i);
    auto swapped = chain;
    std::swap(swapped[i], swapped[i + 1]);
    CHECK(verified_length(swapped, public_key) == i);
    auto repeated = chain;
    repeated.insert(repeated.begin() + static_cast<std::ptrdiff_t>(i), chain[i]);
    CHECK(verified_length(repeated, public_key) == i + 1);
    // Validly signed, with the right number and predecessor: the record after it gives it away.
    auto replaced_one = chain;
    replaced_one[i] =
        sign_next(random_record(random), {chain.begin(), chain.begin() + static_cast<std::ptrdiff_t>(i)}, key);
    CHECK(verified_length(replaced_one, public_key) == i + 1);
  }
}

TEST_CASE("records of two chains of one key cannot be spliced, reordered or shortened in the middle") {
  Keys keys;
  Chain one, two;
  keys.add(one, 6, keys.first);
  keys.add(two, 6, keys.first);
  const PublicKey trusted = keys.first.public_key();
  for (std::size_t i = 1; i < one.size(); ++i) {
    Chain spliced(one.begin(), one.begin() + static_cast<std::ptrdiff_t>(i));
    spliced.insert(spliced.end(), two.begin() + static_cast<std::ptrdiff_t>(i), two.end());
    check_broken(spliced, trusted, i, "it follows a record with SHA-256 ");
    Chain swapped = one;
    std::swap(swapped[i - 1], swapped[i]);
    check_broken(
        swapped, trusted, i - 1,
        "it says that it is record " + std::to_string(i + 1) + " where record " + std::to_string(i) + " should be");
    Chain shorter = one;
    shorter.erase(shorter.begin() + static_cast<std::ptrdiff_t>(i) - 1);
    check_broken(shorter, trusted, i - 1, "it says that it is record " + std::to_string(i + 1));
  }
  // A record that is not there at all.
  const auto gap = visit_verified(
      6, [&](std::uint64_t sequence) { return sequence == 3 ? reader(one)(99) : reader(one)(sequence); }, trusted,
      [](const CalibrationRecord&, const SignedRecord&) {});
  CHECK(gap.error().code == "broken_chain");
  CHECK_THAT(gap.error().context, ContainsSubstring("record 3 does not verify"));
}

// Each bit of each record, by the two means that there are: the record after it names another hash, and the key has
// signed other bytes. The second takes 50 us; CALIBD_BIT_FLIPS=all tries it for every bit, in place of one of each
// byte.
TEST_CASE("every single-bit change of 200 records, of changes of keys too, is detected", "[release-only]") {
  const char* const wanted = std::getenv("CALIBD_BIT_FLIPS");
  const bool all = wanted != nullptr && std::string_view(wanted) == "all";
  Keys keys;
  Chain chain;
  keys.add(chain, 66, keys.first);
  Keys::change(chain, keys.first, keys.second);
  keys.add(chain, 66, keys.second);
  Keys::change(chain, keys.second, keys.third, /*lost=*/true);
  keys.add(chain, 66, keys.third);
  REQUIRE(chain.size() == 200);
  const Anchor anchor = find_anchor(chain.size(), reader(chain), keys.third.public_key());
  ChainVerifier verifier(anchor);
  std::size_t flips = 0;
  for (SignedRecord& record : chain) {
    const std::string sha256 = sha256_hex(record.canonical);
    const auto flipped = [&](std::string& text, std::size_t bit, bool is_hashed) {
      const auto flip = [&] { text[bit / 8] = static_cast<char>(text[bit / 8] ^ (1 << bit % 8)); };
      flip();
      ++flips;
      const bool same_hash = is_hashed && sha256_hex(text) == sha256;
      const bool tried = all || bit % 32 == bit / 32 % 32;
      ChainVerifier next = verifier;
      const auto verified = tried ? next.next(record) : fail(ErrorCode::bad_signature, "not tried");
      flip();
      return same_hash || verified || verified.error().context.empty();
    };
    for (std::size_t bit = 0; bit < 8 * record.canonical.size(); ++bit)
      if (flipped(record.canonical, bit, true)) FAIL("bit " << bit << " of " << record.canonical);
    // Nothing covers the text of the untrusted comments, the first line of a signature file.
    const std::size_t second = split_signatures(record.signature).first.size();
    for (std::size_t bit = 0; bit < 8 * record.signature.size(); ++bit) {
      const std::size_t byte = bit / 8, begin = byte < second ? 0 : second;
      if (byte >= begin + std::string_view("untrusted comment: ").size() && byte < record.signature.find('\n', begin))
        continue;
      if (flipped(record.signature, bit, false)) FAIL("bit " << bit << " of " << record.signature);
    }
    REQUIRE(verifier.next(record));
  }
  CHECK(flips > 1'500'000);
}
