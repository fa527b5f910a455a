// What of a batch's state stands in its bucket already.
#pragma once

#include <map>
#include <string>

#include "core/result.h"

namespace strata::server {

/// What has been put into a bucket: by name below OUT, what tells whether the local file has
/// changed since, and the object's tag. Kept in a file, lest all pictures be put there again by the
/// next batch. Threads: one at a time.
class SavedFiles {
 public:
  struct Entry {
    std::string stamp, etag;  ///< Without blanks.
  };

  /// A file that is not there, or not whole, holds less: then more is put than needed.
  void Load(const std::string& path);
  /// Errors: kIo.
  Result<void> Store() const;

  /// Null: none.
  const Entry* Find(const std::string& name) const;
  void Set(const std::string& name, Entry entry);

 private:
  std::string path_;
  std::map<std::string, Entry> entries_;
};

}  // namespace strata::server
