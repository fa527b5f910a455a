// JSON from an input that may be anything: measured before it is built.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "core/memory_account.h"
#include "core/result.h"

namespace strata::io {

/// A parsed text and the memory it takes from the account.
struct JsonText {
  nlohmann::json root;
  MemoryShare share;
};

/// Parses `text`. Its tree is measured first and taken from `memory` if that is given. A byte order
/// mark is passed over; invalid UTF-8 is an error. `name` and `offset`, where the text stands in
/// the file, are for messages. Errors: kCorruptInput with the byte (syntax, nested deeper than
/// kMostJsonDepth); kOverBudget.
Result<JsonText> ParseJson(std::string_view text, const std::string& name, std::uint64_t offset,
                           MemoryAccount* memory);
inline constexpr int kMostJsonDepth = 256;

/// A value in a JSON tree that says where it is. Reading a value of the wrong kind, or one that is
/// missing, notes a failure and gives a default, so that a reader tests once at the end. The first
/// failure is kept. Both the tree and `failure` must outlive it.
class JsonAt {
 public:
  struct Failure {
    const std::string* name;  ///< The file's.
    Error error;
    bool failed = false;
  };

  JsonAt(const nlohmann::json& value, Failure& failure) : value_(&value), failure_(&failure) {}

  const std::string& pointer() const { return pointer_; }
  bool present() const { return value_ != nullptr; }
  const nlohmann::json* raw() const { return value_; }

  /// The member `key`; absent if there is none. Anything but an object has failed.
  JsonAt operator[](const char* key) const;
  /// Number of elements; 0 if absent. Anything but an array has failed.
  std::size_t size() const;
  /// Precondition: i < size().
  JsonAt at(std::size_t i) const;
  bool is_object() const { return present() && value_->is_object(); }

  std::uint64_t Uint(std::uint64_t most) const;
  std::uint64_t Uint(std::uint64_t most, std::uint64_t fallback) const {
    return present() ? Uint(most) : fallback;
  }
  double Number() const;
  double Number(double fallback) const { return present() ? Number() : fallback; }
  bool Bool(bool fallback) const;
  std::string String() const;
  std::string String(const char* fallback) const { return present() ? String() : fallback; }
  /// The text if it is one, else "": for what nothing depends on.
  std::string Name() const;

  /// Notes "<name>: <pointer>: <what>".
  void Reject(const std::string& what, ErrorCode code = ErrorCode::kCorruptInput) const;

 private:
  JsonAt(const nlohmann::json* value, std::string pointer, Failure* failure)
      : value_(value), pointer_(std::move(pointer)), failure_(failure) {}
  void RejectKind(const char* expected) const;

  const nlohmann::json* value_;
  std::string pointer_;
  Failure* failure_;
};

}  // namespace strata::io
