#include "server/batch/report_page.h"

#include <fcntl.h>
#include <openssl/evp.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iterator>
#include <sstream>
#include <string_view>
#include <utility>

#include "core/version.h"
#include "io/fd.h"
#include "server/batch/names.h"
#include "server/batch/plots.h"
#include "server/human_units.h"

namespace strata::server {
namespace {

constexpr std::size_t kMostPictures = 120, kMostRows = 20'000, kMostPoints = 4'000;
constexpr std::uint64_t kMostPictureBytes = std::uint64_t{16} << 20;

constexpr std::string_view kStyle = R"(
:root{color-scheme:light dark;--line:#8884;--soft:#8882;--accent:#2a7de1;--bad:#c4372b}
body{font:15px/1.5 system-ui,sans-serif;margin:0 auto;max-width:76rem;padding:1.5rem}
h1{font-size:1.6rem;margin:.2rem 0}h2{font-size:1.15rem;margin:2rem 0 .6rem}
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(10rem,1fr));gap:.6rem}
.figures div{border:1px solid var(--line);border-radius:.5rem;padding:.5rem .8rem}
.figures b{display:block;font-size:1.35rem;font-weight:600}.bad{color:var(--bad)}
.plots{display:grid;grid-template-columns:repeat(auto-fit,minmax(24rem,1fr));gap:1rem}
figure{margin:0;min-width:0}figcaption{font-size:.82rem;overflow-wrap:anywhere}
svg{width:100%;height:auto;border:1px solid var(--line);border-radius:.5rem}
svg text{font:11px system-ui,sans-serif;fill:currentColor}svg .axis{stroke:currentColor;opacity:.5}
svg .mark{fill:var(--accent)}svg .grid{stroke:var(--line)}
.pictures{display:grid;grid-template-columns:repeat(auto-fill,minmax(11rem,1fr));gap:.8rem}
.pictures img{width:100%;height:auto;border-radius:.4rem;background:#fff;display:block}
.scroll{overflow:auto;max-height:44rem;border:1px solid var(--line);border-radius:.5rem}
table{border-collapse:collapse;width:100%;font-size:.86rem}
th,td{padding:.25rem .6rem;text-align:left;border-bottom:1px solid var(--soft);vertical-align:top}
td{overflow-wrap:anywhere}.n{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}
.scroll th{position:sticky;top:0;background:Canvas}
th button{font:inherit;font-weight:600;border:0;background:none;color:inherit;padding:0;cursor:pointer}
th[aria-sort=ascending] button::after{content:" \2191"}
th[aria-sort=descending] button::after{content:" \2193"}
)";

constexpr std::string_view kScript = R"(
for (const head of document.querySelectorAll('table.sorts th')) {
  head.querySelector('button').addEventListener('click', () => {
    const table = head.closest('table'), body = table.tBodies[0], at = head.cellIndex;
    const down = head.getAttribute('aria-sort') === 'ascending';
    for (const other of table.querySelectorAll('th')) other.removeAttribute('aria-sort');
    head.setAttribute('aria-sort', down ? 'descending' : 'ascending');
    const value = (row) => row.cells[at].dataset.value ?? row.cells[at].textContent;
    const numbers = head.classList.contains('n');
    const order = numbers ? (a, b) => a - b : (a, b) => (a < b ? -1 : a > b ? 1 : 0);
    const rows = [...body.rows];
    rows.sort((a, b) => (down ? -1 : 1) * order(value(a), value(b)));
    body.append(...rows);
  });
}
)";

std::string Escaped(std::string_view text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

/// A name or message from outside.
std::string Foreign(std::string_view bytes) { return Escaped(Printable(bytes)); }

std::string Base64(std::string_view bytes) {
  std::string text(4 * ((bytes.size() + 2) / 3) + 1, '\0');
  const int n = EVP_EncodeBlock(reinterpret_cast<unsigned char*>(text.data()),
                                reinterpret_cast<const unsigned char*>(bytes.data()),
                                static_cast<int>(bytes.size()));
  text.resize(static_cast<std::size_t>(n));
  return text;
}

/// As a content security policy names the script that it lets run.
std::string ScriptHash() {
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned int size = 0;
  if (EVP_Digest(kScript.data(), kScript.size(), digest, &size, EVP_sha256(), nullptr) != 1) {
    return "none";
  }
  return "sha256-" + Base64({reinterpret_cast<const char*>(digest), size});
}

void Head(std::ostream& out) {
  out << "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
         "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src "
         "data:; "
         "style-src 'unsafe-inline'; script-src '"
      << ScriptHash()
      << "'\">\n<meta name=\"viewport\" content=\"width=device-width\">\n"
         "<title>Strata: report of a batch</title>\n<style>"
      << kStyle << "</style>\n</head>\n<body>\n";
}

void Figure(std::ostream& out, const std::string& value, const char* name, bool bad = false) {
  out << "<div><b" << (bad ? " class=\"bad\"" : "") << '>' << Escaped(value) << "</b>" << name
      << "</div>\n";
}

void Figures(std::ostream& out, const Report& report) {
  out << "<header><h1>Strata: report of a batch</h1>\n<p>" << report.folders.size()
      << (report.folders.size() == 1 ? " folder: " : " folders: ");
  for (std::size_t i = 0; i < report.folders.size(); ++i) {
    out << (i > 0 ? ", " : "") << Foreign(report.folders[i]);
  }
  out << "</p></header>\n<div class=\"figures\">\n";
  Figure(out, Grouped(report.rows.size()), "models");
  Figure(out, Grouped(report.sampled), "sampled");
  Figure(out, Grouped(report.failed), "failed", report.failed > 0);
  Figure(out, Si(static_cast<double>(report.samples)), "samples");
  Figure(out, Si(static_cast<double>(report.triangles)), "triangles");
  Figure(out, Grouped(report.skipped), "triangles skipped");
  Figure(out, Si(static_cast<double>(report.input_bytes)) + "B", "read");
  Figure(out, Si(static_cast<double>(report.output_bytes)) + "B", "written");
  Figure(out, Seconds(report.seconds), "of all models");
  Figure(out, Si(static_cast<double>(report.peak_memory_bytes)) + "B", "peak memory of a worker");
  out << "</div>\n";
}

void Failures(std::ostream& out, const Report& report) {
  if (report.reasons.empty()) return;
  out << "<h2>Failures by reason</h2>\n<table><thead><tr><th>reason</th><th class=\"n\">models"
         "</th><th>one of them</th></tr></thead><tbody>\n";
  for (const auto& entry : report.reasons) {
    const std::string& reason = entry.first;
    const auto first = std::ranges::find_if(report.rows, [&](const ReportRow& row) {
      return !row.line.sampled && row.line.error_type == reason;
    });
    out << "<tr><td>" << Foreign(reason) << "</td><td class=\"n\">" << Grouped(entry.second)
        << "</td><td>" << Foreign(first->line.error_message) << "</td></tr>\n";
  }
  out << "</tbody></table>\n";
}

void Plots(std::ostream& out, const Report& report) {
  std::vector<double> seconds;
  std::vector<PlotPoint> points;
  const std::size_t step = report.rows.size() / kMostPoints + 1;
  for (std::size_t i = 0; i < report.rows.size(); ++i) {
    const ManifestLine& line = report.rows[i].line;
    seconds.push_back(line.measured.seconds);
    if (!line.sampled || i % step != 0) continue;
    points.push_back({line.area, static_cast<double>(line.samples), Foreign(line.path)});
  }
  out << "<h2>Plots</h2>\n<div class=\"plots\">\n<figure>"
      << HistogramSvg(seconds, "seconds a model")
      << "<figcaption>Models by seconds</figcaption></figure>\n<figure>"
      << ScatterSvg(points, "area", "samples") << "<figcaption>Samples against area";
  if (step > 1) out << ", one model in " << step;
  out << "</figcaption></figure>\n</div>\n";
}

/// Whether `bytes` is a PNG: what is not is not put into the page.
bool IsPng(std::string_view bytes) { return bytes.starts_with("\x89PNG\r\n\x1a\n"); }

/// Empty: no picture stands there. A link or pipe in its place is not followed or waited for.
std::string ReadPicture(const ReportRow& row) {
  constexpr off_t kMostBytes = off_t{4} << 20;
  const std::string path = row.folder + '/' + row.line.picture;
  const io::Fd file(open(path.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC));
  struct stat status {};
  const bool good = file && fstat(file.get(), &status) == 0 && S_ISREG(status.st_mode) &&
                    status.st_size <= kMostBytes;
  if (!good) return {};
  std::string png(static_cast<std::size_t>(status.st_size), '\0');
  if (pread(file.get(), png.data(), png.size(), 0) != std::ssize(png)) return {};
  return IsPng(png) ? png : std::string();
}

void Pictures(std::ostream& out, const Report& report) {
  std::ostringstream pictures;
  std::size_t shown = 0, all = 0;
  std::uint64_t bytes = 0;
  for (const ReportRow& row : report.rows) {
    if (row.line.picture.empty()) continue;
    ++all;
    if (shown == kMostPictures || bytes > kMostPictureBytes) continue;
    const std::string png = ReadPicture(row);
    if (png.empty()) continue;
    ++shown;
    bytes += png.size();
    pictures << "<figure><img alt=\"\" src=\"data:image/png;base64," << Base64(png)
             << "\"><figcaption>" << Foreign(row.line.path) << "<br>" << Grouped(row.line.samples)
             << " samples</figcaption></figure>\n";
  }
  if (shown == 0) return;
  out << "<h2>Samples</h2>\n";
  if (shown < all) out << "<p>" << shown << " of " << all << " pictures.</p>\n";
  out << "<div class=\"pictures\">\n" << pictures.str() << "</div>\n";
}

void Number(std::ostream& out, double value, const std::string& text) {
  out << "<td class=\"n\" data-value=\"" << Short(value, 9) << "\">" << text << "</td>";
}

void TableRow(std::ostream& out, const ManifestLine& line) {
  out << "<tr><td>" << Foreign(line.path) << "</td><td>"
      << (line.sampled ? "sampled" : "<span class=\"bad\">" + Foreign(line.error_type) + "</span>")
      << "</td>";
  Number(out, static_cast<double>(line.triangles), Grouped(line.triangles));
  Number(out, line.area, Short(line.area));
  Number(out, static_cast<double>(line.samples), Grouped(line.samples));
  Number(out, static_cast<double>(line.output_bytes), Grouped(line.output_bytes));
  Number(out, line.measured.seconds, Short(line.measured.seconds, 3));
  Number(out, static_cast<double>(line.measured.peak_memory_bytes),
         Si(static_cast<double>(line.measured.peak_memory_bytes)) + "B");
  out << "<td>" << Foreign(WithoutPath(line.error_message, line.path)) << "</td></tr>\n";
}

void Table(std::ostream& out, const Report& report) {
  std::vector<const ManifestLine*> lines;
  for (const ReportRow& row : report.rows) lines.push_back(&row.line);
  if (lines.size() > kMostRows) {
    std::ranges::stable_sort(lines, {}, [](const ManifestLine* line) { return line->sampled; });
    lines.resize(kMostRows);
  }
  out << "<h2>Models</h2>\n";
  if (lines.size() < report.rows.size()) {
    out << "<p>" << Grouped(lines.size()) << " of " << Grouped(report.rows.size())
        << " models, those that failed first.</p>\n";
  }
  out << "<div class=\"scroll\"><table class=\"sorts\"><thead><tr>";
  constexpr std::pair<const char*, const char*> kHeads[] = {
      {"", "model"},    {"", "status"},       {"n", "triangles"},
      {"n", "area"},    {"n", "samples"},     {"n", "output bytes"},
      {"n", "seconds"}, {"n", "peak memory"}, {"", "error"}};
  for (const auto& [kind, name] : kHeads) {
    out << "<th class=\"" << kind << "\"><button>" << name << "</button></th>";
  }
  out << "</tr></thead><tbody>\n";
  for (const ManifestLine* const line : lines) TableRow(out, *line);
  out << "</tbody></table></div>\n";
}

}  // namespace

std::string ReportPage(const Report& report) {
  std::ostringstream out;
  Head(out);
  Figures(out, report);
  Failures(out, report);
  Plots(out, report);
  Pictures(out, report);
  Table(out, report);
  out << "<footer><p>Made by Strata " << kVersion << ".</p></footer>\n<script>" << kScript
      << "</script>\n</body>\n</html>\n";
  return out.str();
}

}  // namespace strata::server
