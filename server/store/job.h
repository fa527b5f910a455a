// What a job is.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/result.h"
#include "server/store/clock.h"

namespace strata::server {

enum class JobState : std::uint8_t { kQueued, kRunning, kSucceeded, kFailed, kCancelled };
inline constexpr int kJobStateCount = 5;

/// Whether nothing changes any more.
constexpr bool IsFinished(JobState state) {
  return state != JobState::kQueued && state != JobState::kRunning;
}

/// What a client asks for.
struct JobRequest {
  std::string model;       ///< A model's name.
  std::string model_hash;  ///< SHA-256 of the content to be sampled, fixed when the job is made.
  std::string options;     ///< In their canonical form: opaque here, at most 64 KiB.
  std::string result_key;  ///< The result's key in the cache.
  std::string client;      ///< Whose idempotency key it is; "" for nobody in particular.
  std::string idempotency_key;  ///< "" for none; at most 255 bytes.
};

struct JobProgress {
  std::string stage;                  ///< "scan", …; "" before the first.
  std::uint64_t done = 0, total = 0;  ///< Bytes of input; total 0: not known.
  bool operator==(const JobProgress&) const = default;
};

/// A finished job's output.
struct JobResult {
  std::string hash;  ///< Of its blob; a strong ETag.
  std::uint64_t size = 0;
  std::string media_type;
  std::string summary;  ///< Opaque here.
};

/// One time that a job was claimed.
struct JobAttempt {
  std::int64_t number = 0;  ///< From 1 on.
  std::string owner;
  Timestamp started;
  std::optional<Timestamp> ended;  ///< Absent while it runs.
  std::string why;                 ///< Why it ended, for people: "succeeded", "its lease ran out".
};

struct Job {
  std::int64_t number = 0;  ///< In the order of creation.
  std::string id;           ///< 32 hex digits that nobody guesses.
  JobRequest request;
  JobState state = JobState::kQueued;
  Timestamp created;
  std::optional<Timestamp> started;  ///< Of the latest attempt.
  std::optional<Timestamp> finished;
  std::int64_t attempts = 0;  ///< How often it was claimed.
  std::string owner;          ///< Who claimed it; "" unless running.
  std::optional<Timestamp> lease_until;
  bool cancel_requested = false;
  JobProgress progress;
  std::uint64_t sequence = 1;       ///< Grows with every change.
  std::optional<Error> error;       ///< If failed.
  std::optional<JobResult> result;  ///< If succeeded.
  std::vector<JobAttempt> history;  ///< In order; empty in lists.
};

}  // namespace strata::server
