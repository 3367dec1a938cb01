#include "tools/chart/page/page.h"

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>

#include "tools/chart/page/figure_text.h"
#include "tools/chart/page/page_html.h"

extern char** environ;

namespace ff::chart {
namespace {

constexpr int kPngWidth = 1280;  // px: twice a chart's own

Error ioError(const std::string& path, const std::string& message) {
  return Error{ErrorCode::kIo, path, "", message, "check the folder's permissions and free space"};
}

// Never half a file under its final name.
Result<void> writeText(const std::string& path, const std::string& text) {
  const std::string part = path + ".part";
  {
    std::ofstream out(part, std::ios::binary | std::ios::trunc);
    out.write(text.data(), static_cast<std::streamsize>(text.size()));
    out.close();
    if (!out) {
      std::remove(part.c_str());
      return ioError(path, "cannot be written");
    }
  }
  if (std::rename(part.c_str(), path.c_str()) != 0) return ioError(path, std::string("cannot be renamed: ") + std::strerror(errno));
  return {};
}

std::string base64(const std::string& bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    uint32_t triple = 0;
    for (size_t k = 0; k < 3; ++k)
      triple = triple << 8 | (i + k < bytes.size() ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    for (size_t k = 0; k < 4; ++k) out += i + k <= bytes.size() ? kDigits[triple >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}

Result<std::string> pictureData(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  static constexpr char kPng[] = "\x89PNG\r\n\x1a\n";
  if (!in || bytes.compare(0, 8, kPng, 8) != 0)
    return Error{ErrorCode::kIo, file.string(), "", in ? "is no PNG" : "cannot be read", "a page's pictures are PNGs beside it"};
  return "data:image/png;base64," + base64(bytes);
}

// rsvg-convert, without a shell. False: there is no such program.
Result<bool> drawPng(const std::string& svg, const std::string& png) {
  const std::string part = png + ".part";
  std::string arguments[] = {"rsvg-convert", "--width", std::to_string(kPngWidth), "--output", part, "--", svg};
  std::array<char*, std::size(arguments) + 1> argv{};
  for (size_t i = 0; i < std::size(arguments); ++i) argv[i] = arguments[i].data();
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
  pid_t child = 0;
  const int failed = ::posix_spawnp(&child, argv[0], &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (failed == ENOENT) return false;
  if (failed != 0) return Error{ErrorCode::kIo, png, "", std::string("rsvg-convert cannot be started: ") + std::strerror(failed), ""};
  int status = 0;
  while (::waitpid(child, &status, 0) < 0)
    if (errno != EINTR) return ioError(png, "rsvg-convert was lost");
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
    std::remove(part.c_str());
    return Error{ErrorCode::kIo, png, "", "rsvg-convert could not draw " + svg, "run it by hand to see why"};
  }
  if (std::rename(part.c_str(), png.c_str()) != 0) return ioError(png, "cannot be renamed");
  return true;
}

}  // namespace

Result<Written> writePage(const Report& report, const std::string& folder, const std::string& name) {
  const std::filesystem::path in(folder);
  std::error_code failed;
  std::filesystem::create_directories(in, failed);
  if (failed) return ioError(folder, "cannot be made: " + failed.message());
  std::vector<std::string> pictures;
  for (const Illustration& p : report.pictures) {
    auto data = pictureData(in / p.file);
    if (!data) return data.error();
    pictures.push_back(std::move(*data));
  }

  Written written;
  const auto write = [&](const std::string& file, const std::string& text) -> Result<void> {
    const std::string path = (in / file).string();
    if (auto ok = writeText(path, text); !ok) return ok;
    written.files.push_back(path);
    return {};
  };
  std::set<std::string> used;
  for (const Chart& chart : report.charts) {
    const std::string word = fileWord(chart.id);
    std::string stem = word;
    for (int i = 2; !used.insert(stem).second; ++i) stem = word + "-" + std::to_string(i);
    if (auto ok = write(stem + ".svg", svgChart(chart)); !ok) return ok.error();
    if (!written.left_out.empty()) continue;
    const std::string png = (in / (stem + ".png")).string();
    const auto drawn = drawPng((in / (stem + ".svg")).string(), png);
    if (!drawn) return drawn.error();
    if (*drawn)
      written.files.push_back(png);
    else
      written.left_out = "PNGs of the charts: rsvg-convert is not there (Debian: librsvg2-bin)";
  }
  if (auto ok = write(name + ".csv", csvTable(report)); !ok) return ok.error();
  if (auto ok = write(name + ".html", htmlPage(report, pictures)); !ok) return ok.error();  // last: it means all is there
  return written;
}

}  // namespace ff::chart
