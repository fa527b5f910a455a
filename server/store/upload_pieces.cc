#include "server/store/upload_pieces.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <vector>

#include "io/output_place.h"
#include "server/store/membership.h"

namespace strata::server {
namespace {

constexpr const char* kFolder = "uploads/";

struct Piece {
  std::uint64_t offset = 0, size = 0;
  std::string name;
};

}  // namespace

Result<void> UploadPieces::Add(UploadInfo& info, int fd, std::uint64_t end, Timestamp expires) {
  ObjectPlace& place = *blobs_.bucket().place;
  const std::string name = kFolder + blobs_.membership().NewName();
  if (auto put = place.Put(name, fd, info.offset, end - info.offset); !put) {
    blobs_.Undo(name);  // It may have come about, and the answer not.
    return put;
  }
  if (auto noted = Note(info, name, end, expires); !noted) {
    // Where the database was away the row may be there nevertheless: then the object has to be.
    if (!IsDatabaseAway(noted.error())) blobs_.Undo(name);
    return noted;
  }
  info.offset = end;
  info.expires = expires;
  return {};
}

Result<void> UploadPieces::Note(const UploadInfo& info, const std::string& name, std::uint64_t end,
                                Timestamp expires) {
  auto session = database_.WriteRows();
  if (!session) return Forward(session);
  if (auto alive = CheckAlive(*session, name.substr(std::string_view(kFolder).size())); !alive) {
    return alive;
  }
  auto updated =
      session->Run("UPDATE uploads SET \"offset\" = ?, expires = ? WHERE id = ? AND holder = ?",
                   static_cast<std::int64_t>(end), ToMillis(expires), info.id, info.holder);
  if (!updated) return Forward(updated);
  if (*updated != 1) {
    return Fail(ErrorCode::kConflict,
                "upload " + info.id + ": another process took it over; go on from its offset");
  }
  auto inserted = session->Run(
      "INSERT INTO upload_pieces (upload, \"offset\", size, name) VALUES (?, ?, ?, ?)", info.id,
      static_cast<std::int64_t>(info.offset), static_cast<std::int64_t>(end - info.offset), name);
  if (!inserted) return Forward(inserted);
  return session->Commit();
}

Result<void> UploadPieces::Fetch(const std::string& upload, int fd, std::uint64_t end) {
  std::vector<Piece> pieces;
  auto listed = database_.Read().Query(
      "SELECT \"offset\", size, name FROM upload_pieces WHERE upload = ? ORDER BY \"offset\"",
      [&](const Row& row) {
        pieces.push_back({static_cast<std::uint64_t>(row.Int(0)),
                          static_cast<std::uint64_t>(row.Int(1)), row.Text(2)});
      },
      upload);
  if (!listed) return Forward(listed);
  std::vector<char> buffer(std::size_t{4} << 20);
  std::uint64_t at = 0;
  for (const Piece& piece : pieces) {
    if (at >= end) break;
    if (piece.offset != at) break;
    for (std::uint64_t done = 0; done < piece.size; done += buffer.size()) {
      const std::size_t now = std::min<std::uint64_t>(buffer.size(), piece.size - done);
      auto read = blobs_.bucket().place->Read(piece.name, done, {buffer.data(), now}, {});
      if (!read) return Fail(ErrorCode::kIo, read.error().message, read.error().kind);
      std::uint64_t written = at + done;
      if (lseek(fd, static_cast<off_t>(written), SEEK_SET) < 0) {
        return FailSystem("uploads/" + upload, "cannot be written", errno);
      }
      if (const int error = io::WriteAll(fd, {buffer.data(), now}, written); error != 0) {
        return FailSystem("uploads/" + upload,
                          "byte " + std::to_string(written) + ": cannot be written", error);
      }
    }
    at += piece.size;
  }
  if (at >= end) return {};
  return Fail(ErrorCode::kInternal, "upload " + upload + ": its pieces end at byte " +
                                        std::to_string(at) + ", expected " + std::to_string(end));
}

Result<void> UploadPieces::Doom(Session& session, const std::string& upload) {
  auto noted = session.Run(
      "INSERT INTO blob_garbage (name) SELECT name FROM upload_pieces WHERE upload = ?"
      " ON CONFLICT (name) DO NOTHING",
      upload);
  if (!noted) return Forward(noted);
  auto deleted = session.Run("DELETE FROM upload_pieces WHERE upload = ?", upload);
  if (!deleted) return Forward(deleted);
  return {};
}

}  // namespace strata::server
