#include "formats/storage/http_storage.h"

#include <curl/curl.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdlib>
#include <map>
#include <mutex>
#include <optional>
#include <thread>

#include "formats/storage/read_only_storage.h"
#include "formats/version.h"

namespace ff::formats {
namespace {

constexpr std::chrono::milliseconds kPause{200};  // before a request is made once more
constexpr const char* kOtherServer = "use a server that sends what it is asked for, such as nginx";

// What an address stands for at one time, as far as the server says: an empty tag or time is unknown.
struct Version {
  uint64_t bytes = 0;
  std::string tag, modified;
  bool differs(const Version& other) const {
    if (bytes != other.bytes) return true;
    if (!tag.empty() && !other.tag.empty()) return tag != other.tag;
    return !modified.empty() && !other.modified.empty() && modified != other.modified;
  }
};

// The beginning of a text, taken off it: a word; a number.
bool take(std::string_view& text, std::string_view word) {
  if (!text.starts_with(word)) return false;
  text.remove_prefix(word.size());
  return true;
}
bool take(std::string_view& text, uint64_t& number) {
  const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (fault == std::errc()) text.remove_prefix(static_cast<size_t>(end - text.data()));
  return fault == std::errc();
}

struct Headers {
  uint64_t status = 0;
  bool ended = false;
  std::string range, encoding, length, tag, modified;

  // Another line of them. An answer before (a redirection) no longer counts.
  void add(std::string_view line) {
    line = line.substr(0, line.find_last_not_of(" \r\n") + 1);
    ended = line.empty();
    if (line.starts_with("HTTP/")) {
      *this = {};
      line.remove_prefix(std::min(line.find(' '), line.size() - 1) + 1);
      (void)take(line, status);
      return;
    }
    const size_t colon = line.find(':');
    if (colon == std::string_view::npos) return;
    std::string name(line.substr(0, colon));
    std::ranges::transform(name, name.begin(), [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
    const std::string_view value = line.substr(std::min(line.find_first_not_of(' ', colon + 1), line.size()));
    const std::pair<const char*, std::string*> known[] = {
        {"content-range", &range}, {"content-encoding", &encoding}, {"content-length", &length}, {"etag", &tag}, {"last-modified", &modified}};
    for (const auto& [key, to] : known)
      if (name == key) *to = value;
  }
};

// A request for bytes from `offset` on, as many as `out` holds or the file has, and what comes of it.
struct Transfer {
  uint64_t offset = 0;
  std::span<std::byte> out;           // shortened to what the file has
  const Version* expected = nullptr;  // null: whatever version there is
  const Version* known = nullptr;     // not null: one with a tag; while it is that, nothing is sent
  Headers headers{};
  Version version{};
  bool judged = false;
  std::string fault{}, remedy{};  // of the answer; empty: it is what was asked for
  uint64_t skip = 0;              // bytes of the body before those wanted
  size_t done = 0;

  bool complete() const { return judged && fault.empty() && done == out.size(); }
  void refuse(const std::string& what, const std::string& to_do) { fault = what, remedy = to_do; }

  // Before the first byte of the body is taken: whether the answer is what was asked for.
  void judge() {
    if (std::exchange(judged, true)) return;
    std::string_view range = headers.range, length = headers.length;
    uint64_t first = 0, last = 0, end = offset + out.size();
    version = {0, headers.tag, headers.modified};
    const std::string answer = std::to_string(headers.status);
    switch (headers.status) {
      case 200:
        if (!take(length, version.bytes)) return refuse("the server sends neither ranges nor the file's size", kOtherServer);
        skip = offset;
        break;
      case 206:
        if (!take(range, "bytes ") || !take(range, first) || !take(range, "-") || !take(range, last) || !take(range, "/") || !take(range, version.bytes) ||
            first != offset || last + 1 != std::min(end, version.bytes))
          return refuse("asked for bytes " + std::to_string(offset) + "-" + std::to_string(end - 1) + ", the server answers with \"" + headers.range + "\"", kOtherServer);
        break;
      case 304:
        if (!known) return refuse("the server answers 304 to what is no question", kOtherServer);
        version = *known;
        out = {};
        return;
      case 416:  // there is nothing of that range: an empty file has none
        if (!take(range, "bytes */") || !take(range, version.bytes)) return refuse("the server refuses the range (416)", kOtherServer);
        break;
      case 401: case 403: case 407:
        return refuse("the server does not let us read it (" + answer + ")", "allow it there, or put name and password into ~/.netrc");
      case 404: case 410:
        return refuse("there is no such file on the server (" + answer + ")", "check the address; one with a query (?) cannot be a world's");
      default: return refuse("the server answers " + answer, "try again later, or look into the server's log");
    }
    if (expected && version.differs(*expected)) return refuse("has changed on the server since it was opened", "open the world again");
    if (!headers.encoding.empty() && headers.encoding != "identity")
      return refuse("the server sends it compressed (" + headers.encoding + "), which was not asked for", "turn compression off there for .ffm and .ffs files");
    end = std::min(end, version.bytes);
    if (headers.status == 200 && end > kMaxWithoutRanges)
      return refuse("the server sends no ranges, but the whole file each time (200 instead of 206)", kOtherServer);
    out = out.first(end - std::min(offset, end));
  }

  // Takes what it can. False: the rest is not wanted.
  bool body(std::span<const std::byte> bytes) {
    judge();
    if (!fault.empty()) return headers.status >= 400 && (skip += bytes.size()) < kFirstRange;  // a page that says what is wrong: the connection is kept
    const auto skipped = static_cast<size_t>(std::min<uint64_t>(skip, bytes.size()));
    skip -= skipped;
    bytes = bytes.subspan(skipped);
    const size_t taken = std::min(bytes.size(), out.size() - done);
    std::copy_n(bytes.begin(), taken, out.begin() + static_cast<std::ptrdiff_t>(done));
    done += taken;
    return taken == bytes.size();
  }
};

// libcurl's callbacks. What they return instead of `bytes` ends the transfer.
size_t onHeader(char* line, size_t, size_t bytes, void* transfer) try {
  static_cast<Transfer*>(transfer)->headers.add({line, bytes});
  return bytes;
} catch (const std::bad_alloc&) {
  return 0;
}
size_t onBody(char* data, size_t, size_t bytes, void* transfer) try {
  return static_cast<Transfer*>(transfer)->body(std::as_bytes(std::span(data, bytes))) ? bytes : 0;
} catch (const std::bad_alloc&) {
  return 0;
}

// One request at a time; the connection stays open for the next. Not thread-safe.
class Connection {
  struct Free {
    void operator()(CURLM* multi) const { curl_multi_cleanup(multi); }
    void operator()(curl_slist* list) const { curl_slist_free_all(list); }
  };
  using List = std::unique_ptr<curl_slist, Free>;
  static constexpr const char* kAsItIs = "Accept-Encoding: identity";

 public:
  explicit Connection(const HttpSettings& settings) {
    static const CURLcode ready = curl_global_init(CURL_GLOBAL_DEFAULT);
    if (ready != CURLE_OK || !multi_ || !easy_) throw std::bad_alloc();
    headers_.reset(curl_slist_append(nullptr, kAsItIs));
    set(CURLOPT_USERAGENT, "Formfield/" FF_VERSION);
    set(CURLOPT_NOSIGNAL, 1L);
    set(CURLOPT_ERRORBUFFER, error_.data());
    set(CURLOPT_HEADERFUNCTION, onHeader);
    set(CURLOPT_WRITEFUNCTION, onBody);
    set(CURLOPT_NETRC, CURL_NETRC_OPTIONAL);
    set(CURLOPT_FOLLOWLOCATION, 1L);
    set(CURLOPT_MAXREDIRS, 5L);
    set(CURLOPT_CONNECTTIMEOUT, static_cast<long>(settings.connect.count()));
    set(CURLOPT_LOW_SPEED_LIMIT, 1L);
    set(CURLOPT_LOW_SPEED_TIME, static_cast<long>(settings.stall.count()));
    for (const char* variable : {"SSL_CERT_FILE", "CURL_CA_BUNDLE"})
      if (const char* file = std::getenv(variable); file && *file) set(CURLOPT_CAINFO, file);
  }

  // Ends early, with CURLE_ABORTED_BY_CALLBACK, where the options say so.
  CURLcode perform(const std::string& address, Transfer& transfer, const ReadOptions& options) {
    const std::string range = std::to_string(transfer.offset) + "-" + std::to_string(transfer.offset + transfer.out.size() - 1);
    const long protocols = CURLPROTO_HTTPS | (address.starts_with("https:") ? 0L : CURLPROTO_HTTP);  // no redirection leaves encryption
#if LIBCURL_VERSION_NUM >= 0x075500
    set(CURLOPT_PROTOCOLS_STR, "http,https");
    set(CURLOPT_REDIR_PROTOCOLS_STR, protocols & CURLPROTO_HTTP ? "http,https" : "https");
#else
    set(CURLOPT_PROTOCOLS, CURLPROTO_HTTP | CURLPROTO_HTTPS);
    set(CURLOPT_REDIR_PROTOCOLS, protocols);
#endif
    set(CURLOPT_URL, address.c_str());
    set(CURLOPT_RANGE, range.c_str());
    const List conditional(transfer.known ? curl_slist_append(curl_slist_append(nullptr, kAsItIs), ("If-None-Match: " + transfer.known->tag).c_str()) : nullptr);
    set(CURLOPT_HTTPHEADER, conditional ? conditional.get() : headers_.get());
    set(CURLOPT_HEADERDATA, &transfer);
    set(CURLOPT_WRITEDATA, &transfer);
    error_[0] = '\0';
    CURLcode outcome = CURLE_ABORTED_BY_CALLBACK;
    if (curl_multi_add_handle(multi_.get(), easy_.get()) != CURLM_OK) return CURLE_OUT_OF_MEMORY;
    int running = 1;
    while (running > 0 && !whyReadEnds(options)) {
      if (curl_multi_perform(multi_.get(), &running) != CURLM_OK) outcome = CURLE_OUT_OF_MEMORY, running = 0;
      if (running > 0) curl_multi_poll(multi_.get(), nullptr, 0, static_cast<int>(kLookAtOptions.count()), nullptr);
    }
    int left = 0;
    if (const CURLMsg* message = curl_multi_info_read(multi_.get(), &left); message && message->msg == CURLMSG_DONE) outcome = message->data.result;
    curl_multi_remove_handle(multi_.get(), easy_.get());
    return outcome;
  }

  std::string why(CURLcode outcome) const { return error_[0] ? error_.data() : curl_easy_strerror(outcome); }

 private:
  template <class Value>
  void set(CURLoption option, Value value) {
    curl_easy_setopt(easy_.get(), option, value);
  }
  std::unique_ptr<CURLM, Free> multi_{curl_multi_init()};
  List headers_;
  struct FreeEasy {
    void operator()(CURL* easy) const { curl_easy_cleanup(easy); }
  };
  std::unique_ptr<CURL, FreeEasy> easy_{curl_easy_init()};
  std::array<char, CURL_ERROR_SIZE> error_{};
};

// The connections that nobody uses at present, and how a request is made.
class Client {
 public:
  explicit Client(const HttpSettings& settings) : settings_(settings) {}

  // Fills transfer.out. Errors as StoredFile::read(); transfer.headers tells what the server said.
  Result<void> fetch(const std::string& address, Transfer& transfer, const ReadOptions& options) {
    std::unique_ptr<Connection> connection = takeOne();
    const Transfer asked = transfer;
    for (bool again = false;; again = true) {
      transfer = asked;
      const CURLcode outcome = connection->perform(address, transfer, options);
      if (outcome == CURLE_OK && transfer.headers.ended) transfer.judge();
      const auto error = [&](const std::string& what, const std::string& remedy) {
        return Error{ErrorCode::kIo, address, "offset " + std::to_string(transfer.offset), what, remedy};
      };
      if (transfer.complete() || !mayPass(outcome, transfer) || again) {
        if (outcome == CURLE_OK || outcome == CURLE_WRITE_ERROR) giveBack(std::move(connection));
        if (transfer.complete()) return {};
        if (const char* ended = whyReadEnds(options)) return error(ended, "");
        if (!transfer.fault.empty()) return error(transfer.fault, transfer.remedy);
        if (outcome == CURLE_PEER_FAILED_VERIFICATION || outcome == CURLE_SSL_CACERT_BADFILE)
          return error(connection->why(outcome), "name a file with the authority of the server's certificate in CURL_CA_BUNDLE");
        return error(outcome == CURLE_OK ? "the answer ends early" : connection->why(outcome), "check the address, the server and the line to it");
      }
      const auto until = std::chrono::steady_clock::now() + kPause;
      while (std::chrono::steady_clock::now() < until && !whyReadEnds(options)) std::this_thread::sleep_for(kLookAtOptions);
    }
  }

 private:
  static bool mayPass(CURLcode outcome, const Transfer& transfer) {
    if (!transfer.fault.empty()) return transfer.headers.status == 408 || transfer.headers.status == 429 || transfer.headers.status >= 500;
    constexpr CURLcode passing[] = {CURLE_OK, CURLE_COULDNT_RESOLVE_HOST, CURLE_COULDNT_CONNECT, CURLE_OPERATION_TIMEDOUT, CURLE_SSL_CONNECT_ERROR, CURLE_PARTIAL_FILE,
                                    CURLE_GOT_NOTHING, CURLE_SEND_ERROR, CURLE_RECV_ERROR, CURLE_HTTP2, CURLE_HTTP2_STREAM, CURLE_WEIRD_SERVER_REPLY};
    return std::ranges::find(passing, outcome) != std::end(passing);
  }
  std::unique_ptr<Connection> takeOne() {
    {
      const std::lock_guard lock(mutex_);
      if (!idle_.empty()) {
        auto connection = std::move(idle_.back());
        idle_.pop_back();
        return connection;
      }
    }
    return std::make_unique<Connection>(settings_);
  }
  void giveBack(std::unique_ptr<Connection> connection) {
    const std::lock_guard lock(mutex_);
    idle_.push_back(std::move(connection));
  }

  const HttpSettings settings_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<Connection>> idle_;
};

class HttpFile final : public StoredFile {
 public:
  // first: its first bytes, which opening it has brought: for the first read.
  HttpFile(std::string path, std::string address, std::shared_ptr<Client> client, Version version, std::vector<std::byte> first)
      : StoredFile(std::move(path)), address_(std::move(address)), client_(std::move(client)), version_(std::move(version)), first_(std::move(first)) {}
  uint64_t bytes() const override { return version_.bytes; }

 private:
  Result<void> readPiece(uint64_t offset, std::span<std::byte> out, const ReadOptions& options) const override {
    if (offset > bytes() || out.size() > bytes() - offset) return endsEarly(bytes());
    std::vector<std::byte> first;
    {
      const std::lock_guard lock(mutex_);
      first.swap(first_);
    }
    if (offset + out.size() <= first.size()) {
      std::copy_n(first.begin() + static_cast<std::ptrdiff_t>(offset), out.size(), out.begin());
      return {};
    }
    Transfer transfer{offset, out, &version_};
    return client_->fetch(address_, transfer, options);
  }

  const std::string address_;
  const std::shared_ptr<Client> client_;
  const Version version_;
  mutable std::mutex mutex_;
  mutable std::vector<std::byte> first_;
};

// What stands for itself in an address; the rest of a path, as a shard's name may have it, is written in hexadecimal digits.
std::string addressOf(const std::string& path) {
  constexpr std::string_view kPlain = "-._~/:@!$&'()*+,;=%[]";
  std::string address;
  for (const char c : path) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || kPlain.find(c) != std::string_view::npos;
    const auto byte = static_cast<unsigned char>(c);
    if (plain)
      address += c;
    else
      (address += '%') += {"0123456789ABCDEF"[byte >> 4], "0123456789ABCDEF"[byte & 15]};
  }
  return address;
}

class HttpStorage final : public ReadOnlyStorage {
 public:
  explicit HttpStorage(const HttpSettings& settings) : client_(std::make_shared<Client>(settings)) {}

  Result<std::unique_ptr<StoredFile>> open(const std::string& path, const ReadOptions& options) override {
    uint64_t status = 0;
    return openWith(path, options, status);
  }
  // Where names are not told to strangers a file that is absent is forbidden (403).
  Result<bool> exists(const std::string& path) override {
    uint64_t status = 0;
    if (auto file = openWith(path, {}, status); file) return true;
    else if (status == 403 || status == 404 || status == 410) return false;
    else return file.error();
  }
  Result<std::string> version(const std::string& path, const ReadOptions& options) override {
    std::vector<std::byte> first(1);
    uint64_t status = 0;
    const std::optional<Version> known = lastVersion(path);
    const auto version = fetchFirst(path, first, options, status, known ? &*known : nullptr);
    if (!version) return version.error();
    keepVersion(path, *version);
    return std::to_string(version->bytes) + ' ' + version->tag + ' ' + version->modified;
  }

 private:
  // Of those who ask for it again and again.
  std::optional<Version> lastVersion(const std::string& path) const {
    const std::lock_guard lock(mutex_);
    const auto at = versions_.find(path);
    return at != versions_.end() ? std::optional(at->second) : std::nullopt;
  }
  // A time alone is not enough to be asked for: a file of another size may have the same.
  void keepVersion(const std::string& path, const Version& version) {
    const std::lock_guard lock(mutex_);
    versions_.erase(path);
    if (!version.tag.empty()) versions_.emplace(path, version);
  }
  // The first bytes of a file, as many as `first` holds or the file has; none where it still is the version that is known.
  Result<Version> fetchFirst(const std::string& path, std::vector<std::byte>& first, const ReadOptions& options, uint64_t& status, const Version* known = nullptr) try {
    const size_t host = path.find("//") + 2, at = path.find('@', host);
    if (at < path.find('/', host))
      return Error{ErrorCode::kIo, path.substr(0, host) + "..." + path.substr(at), "", "has a password in its address, where others would see it", "put it into ~/.netrc"};
    Transfer transfer{0, first, nullptr, known};
    auto fetched = client_->fetch(addressOf(path), transfer, options);
    status = transfer.headers.status;
    if (!fetched) return fetched.error();
    first.resize(transfer.done);
    return transfer.version;
  } catch (const std::bad_alloc&) {
    return Error{ErrorCode::kIo, path, "", "out of memory", "close other programs"};
  }
  Result<std::unique_ptr<StoredFile>> openWith(const std::string& path, const ReadOptions& options, uint64_t& status) try {
    std::vector<std::byte> first(kFirstRange);
    auto version = fetchFirst(path, first, options, status);
    if (!version) return version.error();
    return std::unique_ptr<StoredFile>(std::make_unique<HttpFile>(path, addressOf(path), client_, std::move(*version), std::move(first)));
  } catch (const std::bad_alloc&) {
    return Error{ErrorCode::kIo, path, "", "out of memory", "close other programs"};
  }

  const std::shared_ptr<Client> client_;
  mutable std::mutex mutex_;
  std::map<std::string, Version> versions_;  // by path
};

}  // namespace

StoragePtr httpStorage(const HttpSettings& settings) { return std::make_shared<HttpStorage>(settings); }

}  // namespace ff::formats
