// ZIP archives made by hand.
#pragma once

#include <archive.h>
#include <archive_entry.h>

#include <string>
#include <utility>
#include <vector>

namespace strata::test {

/// The members of `files`, names and bytes; a name that ends in '@' becomes a symbolic link to its
/// bytes.
inline std::string MakeZip(const std::vector<std::pair<std::string, std::string>>& files) {
  std::string bytes(std::size_t{1} << 16, '\0');
  for (const auto& [name, content] : files) bytes.resize(bytes.size() + content.size() + 1024);
  std::size_t used = 0;
  archive* const a = archive_write_new();
  archive_write_set_format_zip(a);
  archive_write_open_memory(a, bytes.data(), bytes.size(), &used);
  archive_entry* const entry = archive_entry_new();
  for (const auto& [name, content] : files) {
    archive_entry_clear(entry);
    const bool link = name.ends_with('@');
    archive_entry_set_pathname(entry, name.substr(0, name.size() - (link ? 1 : 0)).c_str());
    archive_entry_set_perm(entry, 0644);
    archive_entry_set_filetype(entry, link ? AE_IFLNK : AE_IFREG);
    if (link) {
      archive_entry_set_symlink(entry, content.c_str());
    } else {
      archive_entry_set_size(entry, static_cast<la_int64_t>(content.size()));
    }
    archive_write_header(a, entry);
    if (!link) archive_write_data(a, content.data(), content.size());
  }
  archive_entry_free(entry);
  archive_write_close(a);
  archive_write_free(a);
  bytes.resize(used);
  return bytes;
}

/// A 3MF package around the text of its model.
inline std::string Make3mf(const std::string& model,
                           std::vector<std::pair<std::string, std::string>> more = {}) {
  std::vector<std::pair<std::string, std::string>> files = {
      {"[Content_Types].xml",
       "<Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\"/>"},
      {"_rels/.rels",
       "<Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">"
       "<Relationship Target=\"/3D/3dmodel.model\" Id=\"r\" "
       "Type=\"http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel\"/></Relationships>"},
      {"3D/3dmodel.model", model}};
  files.insert(files.end(), more.begin(), more.end());
  return MakeZip(files);
}

/// The start of a model: core and production namespaces, `attributes` besides.
inline std::string ModelTag(const std::string& attributes = "") {
  return "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<model " + attributes +
         " xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\""
         " xmlns:p=\"http://schemas.microsoft.com/3dmanufacturing/production/2015/06\">";
}
/// A mesh object: the tetrahedron at the origin.
inline std::string Tetrahedron(int id) {
  return "<object id=\"" + std::to_string(id) +
         "\" type=\"model\"><mesh><vertices><vertex x=\"0\" y=\"0\" z=\"0\"/>"
         "<vertex x=\"1\" y=\"0\" z=\"0\"/><vertex x=\"0\" y=\"1\" z=\"0\"/>"
         "<vertex x=\"0\" y=\"0\" z=\"0.1\"/></vertices><triangles>"
         "<triangle v1=\"0\" v2=\"2\" v3=\"1\"/><triangle v1=\"0\" v2=\"1\" v3=\"3\"/>"
         "<triangle v1=\"1\" v2=\"2\" v3=\"3\"/><triangle v1=\"2\" v2=\"0\" v3=\"3\"/>"
         "</triangles></mesh></object>";
}

}  // namespace strata::test
