#include <map>

#include "message_ids.hpp"
#include "service.hpp"

namespace calib {
namespace {

std::string uid_text(std::uint64_t uid) { return "uid:" + std::to_string(uid); }

/// As the kernel has it, where this process may look; else as the client's program says.
std::string login_of(const Said& said, const Peer& peer) {
  if (peer.login) return uid_text(*peer.login);
  return said.login ? "client:" + uid_text(*said.login) : "";
}

Comment comment_of(const Said& said, const Peer& peer) {
  return {said.comment, said.comment.empty() ? "" : login_of(said, peer)};
}

}  // namespace

Result<Answer> Service::recalibrate(std::size_t index, std::string asked_by, bool dry_run, Comment comment) {
  Pair& pair = *pairs_[index];
  Recalibrate request{.asked_by = std::move(asked_by),
                      .dry_run = dry_run,
                      .found = pair.pipeline.search(pair.state, [this] { return keep_going(); }),
                      .comment = std::move(comment)};
  auto answer = apply_request(pair, pair.pipeline.decide(pair.state, request, now(pair)));
  pair.state.run.last_window.reset();  // a recalibration is no part of a cycle
  return answer;
}

Result<Answer> Service::accept(std::size_t index, std::string asked_by, Comment comment) {
  Pair& pair = *pairs_[index];
  Accept request{.asked_by = std::move(asked_by), .proposal = {}, .comment = std::move(comment)};
  if (pair.state.proposed_record) {
    auto proposal = ledger_.find(pair.config->name, *pair.state.proposed_record);
    if (!proposal) return fail(ErrorCode::failed, proposal.error().context);
    request.proposal = std::move(*proposal);
  }
  return apply_request(pair, pair.pipeline.decide(pair.state, request, now(pair)));
}

Result<Answer> Service::roll_back(std::size_t index, std::optional<std::uint64_t> to, std::string asked_by,
                                  Comment comment) {
  Pair& pair = *pairs_[index];
  const std::string& name = pair.config->name;
  RollBack request{.asked_by = std::move(asked_by), .target = {}, .comment = std::move(comment)};
  if (const CalibrationRecord* before = ledger_.history(name).before_in_force(); !to && before != nullptr)
    to = before->sequence;
  if (to) {
    auto target = ledger_.find(name, *to);
    if (!target)
      return fail(target.error().code == ErrorCode::record_not_found ? ErrorCode::not_found : ErrorCode::failed,
                  target.error().context);
    request.target = std::move(*target);
  }
  return apply_request(pair, pair.pipeline.decide(pair.state, request, now(pair)));
}

Result<Answer> Service::change_key(Ledger::NewKey request) {
  std::map<std::string_view, const PairState*> states;
  for (const auto& pair : pairs_) states.emplace(pair->config->name, &pair->state);
  const bool doubts = request.doubted_from.has_value();
  const auto record = ledger_.change_key(std::move(request), states, surroundings_.clock());
  if (!record) return propagate(record);
  surroundings_.log(5, message_ids::key_changed, "record " + std::to_string(record->sequence) + ": " + record->reason);
  for (const auto& owned : pairs_) {
    Pair& pair = *owned;
    pair.has_evidence_since = false;
    pair.unsaved_since.reset();
    const CalibrationRecord in_force = *ledger_.history(pair.config->name).in_force();
    if (in_force.sequence != 0 && !doubts) continue;
    // What was taken over from the configuration unsigned is signed now; what rests on doubted records is learned anew.
    PairDecision decision;
    decision.state = doubts ? pair.pipeline.without_evidence(pair.state, now(pair)) : pair.state;
    if (doubts) decision.state->run.pairs = 0;  // nothing is claimed before a pair was evaluated anew
    if (in_force.sequence == 0) decision.record = in_force;
    if (commit(pair, decision)) publish(pair, decision);
  }
  collect_status();
  return Answer{.decision = Decision::key_changed, .reason = record->reason, .record = record->sequence};
}

ControlReply Service::answer(const RecalibrationRequest& request, const PendingRequest& pending) {
  return change(request.pair, pending.peer, request.dry_run, [&](std::size_t pair, std::string asked_by) {
    return recalibrate(pair, std::move(asked_by), request.dry_run, comment_of(request.said, pending.peer));
  });
}

ControlReply Service::answer(const AcceptRequest& request, const PendingRequest& pending) {
  return change(request.pair, pending.peer, false, [&](std::size_t pair, std::string asked_by) {
    return accept(pair, std::move(asked_by), comment_of(request.said, pending.peer));
  });
}

ControlReply Service::answer(const RollbackRequest& request, const PendingRequest& pending) {
  return change(request.pair, pending.peer, false, [&](std::size_t pair, std::string asked_by) {
    return roll_back(pair, request.to, std::move(asked_by), comment_of(request.said, pending.peer));
  });
}

/// The next key is read from the file that came along: the secret is in no message, and in no memory but the key's own.
ControlReply Service::answer(const KeyRequest& request, const PendingRequest& pending) {
  const Peer& peer = pending.peer;
  if (!peer.may_change_keys) return Error{ErrorCode::denied, "only root and the daemon's user may change the key"};
  Comment comment = comment_of(request.said, peer);
  comment.login = login_of(request.said, peer);
  Ledger::NewKey next{
      .key = {}, .doubted_from = request.doubted_from, .asked_by = uid_text(peer.uid), .comment = std::move(comment)};
  if (!request.lost) {
    if (!pending.file) return Error{ErrorCode::bad_request, "the file of the next key has to come with the request"};
    auto key = SigningKey::load(pending.file->fd, "the file of the next key");
    if (!key) return Error{ErrorCode::bad_request, key.error().context};
    next.key = std::move(*key);
  }
  auto changed = change_key(std::move(next));
  return changed ? ControlReply(std::move(*changed)) : ControlReply(changed.error());
}

/// What changes something, if the peer may ask for that.
ControlReply Service::change(const std::string& name, const Peer& peer, bool dry_run,
                             const std::function<Result<Answer>(std::size_t pair, std::string asked_by)>& make) {
  if (!peer.may_change)
    return Error{ErrorCode::denied, "only root, the daemon's user and members of its group may ask for changes"};
  const auto pair = find(name);
  if (!pair) return pair.error();
  if (const auto& refused = ledger_.signing_refused(); refused && !dry_run)
    return Error{ErrorCode::wrong_key, "this needs a signed record, and signing is refused: " + *refused};
  auto answer = make(*pair, uid_text(peer.uid));
  return answer ? ControlReply(std::move(*answer)) : ControlReply(answer.error());
}

}  // namespace calib
