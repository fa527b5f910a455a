// Ending calls to a bucket when their caller wants to.
#pragma once

#include <functional>

namespace strata::server {

/// While it lives, calls that this thread makes to a bucket end when `gone` says so. Nests.
class GoneScope {
 public:
  explicit GoneScope(const std::function<bool()>& gone) : former_(current_) { current_ = &gone; }
  ~GoneScope() { current_ = former_; }
  GoneScope(const GoneScope&) = delete;
  GoneScope& operator=(const GoneScope&) = delete;

  /// Whether the caller of this thread's call is gone. An S3Client asks it in the thread that
  /// waits.
  static bool Gone() { return current_ != nullptr && *current_ && (*current_)(); }

 private:
  inline static thread_local const std::function<bool()>* current_ = nullptr;
  const std::function<bool()>* former_;
};

}  // namespace strata::server
