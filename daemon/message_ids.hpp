#pragma once

#include <string_view>

/// Journal message ids (MESSAGE_ID=): one per kind of event, never changed, explained for operators in
/// systemd/calibd.catalog (`journalctl -x`). `journalctl MESSAGE_ID=195bf4e8badc40ee9e9ae7764931bfd4` finds every
/// drift.
namespace calib::message_ids {

inline constexpr std::string_view drift_suspected = "ae07ce8c1c0e4a43a021844cb14ff2bb";
inline constexpr std::string_view drifted = "195bf4e8badc40ee9e9ae7764931bfd4";
inline constexpr std::string_view cleared = "78449e8e29f24b7385bb07ecb0b89fb9";
inline constexpr std::string_view not_evaluated = "c098acc0a9a84e05b58af373141c9488";
inline constexpr std::string_view recalibration_accepted = "da578ff9d4c348cbb34d20c3c946afd7";
inline constexpr std::string_view recalibration_proposed = "33dd6c9111c9485d8b2a44882bdbd5c8";
inline constexpr std::string_view recalibration_rejected = "5df19aab885041a8ae57ee2d433e6fea";
inline constexpr std::string_view rolled_back = "748027cca09f48b6b0b7c6ae95c9f61b";
inline constexpr std::string_view baseline_learned = "eb6cdaad8cc040ba8f0f63cb3357e789";
inline constexpr std::string_view probation_passed = "226309bc3e1a45c0b2f85a69b1d6798a";
inline constexpr std::string_view sensor_silent = "cdcc0123fd9942c39ee5f4f10c8541cf";
inline constexpr std::string_view depth_failed = "ac6348fdca7444b8b1f2d236c7508c68";
inline constexpr std::string_view depth_prepared = "fcdfb253307c4ac6ab0cdbc80c56e583";
inline constexpr std::string_view store_failed = "36d51b88823347e3b01ded9d1f0d96f0";
inline constexpr std::string_view evidence_set_aside = "c2e702a545d545ea8f01bc71eabdcb5f";
inline constexpr std::string_view records_missing = "58fe3ddd650a441487f821d39b9916b3";
inline constexpr std::string_view signing_refused = "659911c4423f42cdb68a2f64ffc566bf";
inline constexpr std::string_view key_changed = "b7ca60f3bc0145f597a520a872106089";
inline constexpr std::string_view bus_failed = "dd3a3ce307864957942390745f8b86ec";
inline constexpr std::string_view dds_complains = "5d2db67d9f774efb85ae440053915cd8";
inline constexpr std::string_view extrinsic_configured = "395ae7172d8f472b88571280c09f882d";
inline constexpr std::string_view start_refused = "0d8b31ff8534414099414d0d170c04d8";
inline constexpr std::string_view configuration_reloaded = "3c1860a9956b4045b5cc7e80a81b9d5a";
inline constexpr std::string_view configuration_refused = "45b4b2e5ee6947419aa12b66d3fc20c6";
inline constexpr std::string_view snapshot_failed = "a2e1c201fcfd475ab3462404e5654036";

}  // namespace calib::message_ids
