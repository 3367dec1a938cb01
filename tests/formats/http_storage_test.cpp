// Files behind a web server: one in this process that misbehaves in every way that is known of servers and lines, and Debian's nginx.
#include "formats/storage/http_storage.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <filesystem>
#include <random>

#include "formats/read/whole_world.h"
#include "formats/storage/cached_storage.h"
#include "formats/storage/memory_storage.h"
#include "formats/storage/piece_memory.h"
#include "tests/formats/faulty_storage.h"
#include "tests/support/nginx.h"
#include "tests/support/random_world.h"
#include "tests/support/web_server.h"

namespace ff::formats {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

std::string noise(size_t bytes) {
  std::mt19937 random(7);
  std::string text(bytes, '\0');
  for (char& c : text) c = static_cast<char>(random());
  return text;
}

std::string textOf(std::span<const std::byte> bytes) { return {reinterpret_cast<const char*>(bytes.data()), bytes.size()}; }

Result<std::string> readText(const StoredFile& file, uint64_t offset, size_t bytes, const ReadOptions& options = {}) {
  std::vector<std::byte> out(bytes);
  if (auto ok = file.read(offset, out, options); !ok) return ok.error();
  return textOf(out);
}

class Http : public testing::Test {
 protected:
  Http() { server_.files["/w.ffm"] = content_; }
  std::string address(const std::string& path = "/w.ffm") const { return server_.address(path); }
  std::unique_ptr<StoredFile> open(const std::string& path = "/w.ffm") {
    auto file = storage_->open(address(path));
    EXPECT_TRUE(file) << file.error().line();
    return file ? std::move(*file) : nullptr;
  }
  // Spoils each answer but that to the opening, or every one; and counts from there.
  void spoil(std::function<void(WebServer::Reply&)> how, bool opening = false) {
    server_.spoil = [how = std::move(how), opening](const WebServer::Request& request, WebServer::Reply& reply) {
      if (opening || request.first > 0) how(reply);
    };
    server_.requests = 0;
  }
  // The error of a read at kAt, which names address and offset.
  Error refusal(const StoredFile& file) {
    const auto read = readText(file, kAt, 100);
    EXPECT_FALSE(read);
    if (read) return {};
    EXPECT_EQ(read.error().file, address());
    EXPECT_EQ(read.error().place, "offset " + std::to_string(kAt));
    EXPECT_EQ(read.error().code, ErrorCode::kIo);
    return read.error();
  }
  static void expectSays(const Error& error, const std::string& what) { EXPECT_NE(error.line().find(what), std::string::npos) << error.line(); }

  static constexpr uint64_t kAt = 200000;
  const std::string content_ = noise(300000);
  WebServer server_;
  StoragePtr storage_ = httpStorage({.connect = 5s, .stall = 5s});
};

TEST_F(Http, AsksForJustTheBytesThatAreReadOnOneConnection) {
  std::string headers;
  server_.spoil = [&](const WebServer::Request& request, WebServer::Reply&) { headers = request.headers; };
  const auto file = open();
  EXPECT_EQ(file->bytes(), content_.size());
  EXPECT_EQ(*readText(*file, 10, 20), content_.substr(10, 20)) << "of what opening has brought";
  EXPECT_EQ(server_.requests, 1u);
  EXPECT_EQ(*readText(*file, kAt, 100), content_.substr(kAt, 100));
  EXPECT_NE(headers.find("Range: bytes=200000-200099\r\n"), std::string::npos) << headers;
  EXPECT_NE(headers.find("Accept-Encoding: identity\r\n"), std::string::npos) << headers;
  EXPECT_EQ(*readText(*file, content_.size() - 1, 1), content_.substr(content_.size() - 1));
  EXPECT_EQ(server_.requests, 3u);
  EXPECT_EQ(server_.connections, 1u);
  EXPECT_EQ(server_.body_bytes, kFirstRange + 100 + 1);
  const auto past = readText(*file, content_.size() - 1, 2);
  ASSERT_FALSE(past);
  EXPECT_EQ(past.error().code, ErrorCode::kInvalidFile);
}

TEST_F(Http, ReadsAsManyAtATimeAsThereAreThreadsAndKeepsTheirConnections) {
  const auto file = open();
  spoil([](WebServer::Reply& reply) { reply.delay = 100ms; });
  for (int round = 0; round < 2; ++round) {
    std::vector<std::thread> threads;
    for (size_t k = 0; k < 12; ++k)
      threads.emplace_back([&, k] { EXPECT_EQ(*readText(*file, kAt + 1000 * k, 100), content_.substr(kAt + 1000 * k, 100)); });
    for (std::thread& thread : threads) thread.join();
    EXPECT_LE(server_.connections, 12u) << "round " << round;
  }
  EXPECT_GE(server_.most_at_a_time, 6u);
}

TEST_F(Http, SaysWhatIsAbsentForbiddenAndEmpty) {
  server_.files["/empty.ffm"] = "";
  server_.files["/secret.ffm"] = "x";
  server_.spoil = [](const WebServer::Request& request, WebServer::Reply& reply) {
    if (request.path == "/secret.ffm") reply.status = 403;
  };
  EXPECT_EQ(open("/empty.ffm")->bytes(), 0u);
  const auto absent = storage_->open(address("/no.ffm")), secret = storage_->open(address("/secret.ffm"));
  ASSERT_FALSE(absent);
  expectSays(absent.error(), "there is no such file on the server (404)");
  ASSERT_FALSE(secret);
  expectSays(secret.error(), "~/.netrc");
  EXPECT_EQ(server_.requests, 3u) << "what is absent is asked for once";
  EXPECT_TRUE(*storage_->exists(address()));
  EXPECT_FALSE(*storage_->exists(address("/no.ffm")));
  EXPECT_FALSE(*storage_->exists(address("/secret.ffm")));
  EXPECT_EQ(server_.connections, 1u);
}

TEST_F(Http, ReadsFromAServerWithoutRangesWhatLiesNearTheBeginning) {
  server_.files["/large.ffs"] = noise(kMaxWithoutRanges + 100);
  server_.spoil = [&](const WebServer::Request& request, WebServer::Reply& reply) {
    reply.status = 200;
    reply.headers = "";
    reply.body = server_.files[request.path];
    reply.length = std::to_string(reply.body.size());
  };
  const auto file = open();
  EXPECT_EQ(file->bytes(), content_.size());
  EXPECT_EQ(*readText(*file, kAt, 1000), content_.substr(kAt, 1000));
  const auto large = open("/large.ffs");
  EXPECT_EQ(*readText(*large, kMaxWithoutRanges - 100, 100), server_.files["/large.ffs"].substr(kMaxWithoutRanges - 100, 100));
  const auto beyond = readText(*large, kMaxWithoutRanges - 50, 100);
  ASSERT_FALSE(beyond);
  expectSays(beyond.error(), "200 instead of 206");
}

TEST_F(Http, RefusesOtherRangesThanItAskedFor) {
  const auto file = open();
  for (const char* range : {"bytes 200001-200100/300000", "bytes 0-99/300000", "bytes 200000-200098/300000", "bytes 200000-200100/300000", "bytes 200000-200099/*", "lines 1-2/3", ""}) {
    spoil([&](WebServer::Reply& reply) { reply.headers = *range ? std::string("Content-Range: ") + range + "\r\n" : ""; });
    const Error error = refusal(*file);
    expectSays(error, "asked for bytes 200000-200099, the server answers with \"" + std::string(range) + "\"");
    EXPECT_EQ(server_.requests, 1u);
  }
}

TEST_F(Http, RefusesBytesThatAreCompressed) {
  const auto file = open();
  spoil([](WebServer::Reply& reply) { reply.headers += "Content-Encoding: gzip\r\n"; });
  expectSays(refusal(*file), "compressed (gzip)");
}

TEST_F(Http, TellsAVersionByARequestOfOneByte) {
  const auto first = storage_->version(address());
  ASSERT_TRUE(first) << first.error().line();
  EXPECT_EQ(server_.requests, 1u);
  EXPECT_EQ(server_.body_bytes, 1u);
  EXPECT_EQ(*storage_->version(address()), *first);
  spoil([](WebServer::Reply& reply) { reply.headers += "ETag: \"2\"\r\n"; }, true);
  EXPECT_NE(*storage_->version(address()), *first);
  spoil([](WebServer::Reply& reply) { reply.headers += "Last-Modified: Sat, 28 Nov 2026 00:00:00 GMT\r\n"; }, true);
  EXPECT_NE(*storage_->version(address()), *first);
  EXPECT_FALSE(storage_->version(address("/none.ffm")));
}

TEST_F(Http, SaysThatAFileHasChangedOnTheServer) {
  for (const auto& [tag, modified, size] : {std::tuple{"2", "", "300000"}, {"1", "", "300001"}, {"", "Sat, 28 Nov 2026 00:00:00 GMT", "300000"}}) {
    server_.spoil = [](const WebServer::Request&, WebServer::Reply& reply) { reply.headers += "Last-Modified: Fri, 27 Nov 2026 00:00:00 GMT\r\n"; };
    const auto file = open();
    spoil([&](WebServer::Reply& reply) {
      reply.headers = std::string(*tag ? "ETag: \"" + std::string(tag) + "\"\r\n" : "") + (*modified ? "Last-Modified: " + std::string(modified) + "\r\n" : "") +
                      "Content-Range: bytes 200000-200099/" + size + "\r\n";
    });
    expectSays(refusal(*file), "has changed on the server since it was opened; open the world again");
  }
}

TEST_F(Http, AsksOnceMoreWhereThatMayHelp) {
  const auto file = open();
  const std::pair<const char*, std::function<void(WebServer::Reply&)>> faults[] = {
      {"closed without an answer", [](WebServer::Reply& reply) { reply.cut = 0; }},
      {"closed within the headers", [](WebServer::Reply& reply) { reply.cut = 30; }},
      {"closed within the body", [](WebServer::Reply& reply) { reply.cut = reply.headers.size() + 100; }},
      {"shorter than it says", [](WebServer::Reply& reply) { reply.body.pop_back(), reply.length = ""; }},
      {"overloaded", [](WebServer::Reply& reply) { reply = {.status = 503, .headers = "", .body = "busy", .length = "4"}; }}};
  for (const auto& [what, fault] : faults) {
    std::atomic<bool> first = true;
    spoil([&](WebServer::Reply& reply) {
      if (first.exchange(false)) fault(reply);
    });
    const auto read = readText(*file, kAt, 100);
    ASSERT_TRUE(read) << what << ": " << read.error().line();
    EXPECT_EQ(*read, content_.substr(kAt, 100)) << what;
    EXPECT_EQ(server_.requests, 2u) << what;
    spoil(fault);
    (void)refusal(*file);
    EXPECT_LE(server_.requests, 3u) << what << "; libcurl itself tries once more where a connection that was kept turns out to be closed";
  }
}

TEST_F(Http, SaysThatNobodyAnswers) {
  std::string nowhere;
  {
    const WebServer gone;
    nowhere = gone.address("/w.ffm");
  }
  const auto file = storage_->open(nowhere);
  ASSERT_FALSE(file);
  EXPECT_EQ(file.error().file, nowhere);
  expectSays(file.error(), "onnect");  // libcurl's words
  EXPECT_FALSE(storage_->exists(nowhere)) << "which is not the same as an absent file";
}

TEST_F(Http, WaitsForASlowStartButNotForEver) {
  storage_ = httpStorage({.connect = 5s, .stall = 2s});
  const auto file = open();
  spoil([](WebServer::Reply& reply) { reply.delay = 1200ms; });
  EXPECT_EQ(*readText(*file, kAt, 100), content_.substr(kAt, 100));
  EXPECT_EQ(server_.requests, 1u);
  spoil([](WebServer::Reply& reply) { reply.delay = 60s; });
  const auto start = Clock::now();
  expectSays(refusal(*file), "check the address, the server and the line to it");
  EXPECT_LT(Clock::now() - start, 20s);
  EXPECT_EQ(server_.requests, 2u);
}

TEST_F(Http, AReadUnderWayCanBeCancelledAndHasADeadline) {
  const auto file = open();
  spoil([](WebServer::Reply& reply) { reply.delay = 60s; });
  const auto start = Clock::now();
  const auto late = readText(*file, kAt, 100, {.deadline = Clock::now() + 100ms});
  ASSERT_FALSE(late);
  expectSays(late.error(), "deadline");
  std::atomic<bool> cancelled = false;
  std::thread canceller([&] {
    std::this_thread::sleep_for(100ms);
    cancelled = true;
  });
  const auto stopped = readText(*file, kAt, 100, {.cancelled = &cancelled});
  canceller.join();
  ASSERT_FALSE(stopped);
  expectSays(stopped.error(), "cancelled");
  EXPECT_LT(Clock::now() - start, 4s) << "the server's 60 s were not waited for, nor the 5 s of a line that stands still";
  server_.spoil = nullptr;
  EXPECT_EQ(*readText(*file, kAt, 100), content_.substr(kAt, 100));
}

TEST_F(Http, FollowsRedirectionsToWebServersOnly) {
  server_.spoil = [&](const WebServer::Request& request, WebServer::Reply& reply) {
    const std::map<std::string, std::string> to = {{"/moved", address()}, {"/round", address("/round")}, {"/file", "file:///etc/hostname"}};
    if (const auto at = to.find(request.path); at != to.end()) reply = {.status = 302, .headers = "ETag: \"of the redirection\"\r\nLocation: " + at->second + "\r\n", .body = "", .length = "0"};
  };
  const auto file = open("/moved");
  EXPECT_EQ(*readText(*file, kAt, 100), content_.substr(kAt, 100));
  for (const char* path : {"/round", "/file"}) {
    const auto refused = storage_->open(address(path));
    ASSERT_FALSE(refused) << path;
    EXPECT_EQ(refused.error().file, address(path));
  }
}

TEST_F(Http, WritesNamesAsAddressesHaveThemAndNoPasswords) {
  server_.files["/my%20town%3F.ffm"] = "light";
  EXPECT_EQ(open("/my town?.ffm")->bytes(), 5u);
  EXPECT_EQ(open("/my%20town%3F.ffm")->bytes(), 5u);
  const auto refused = storage_->open("http://somebody:secret@127.0.0.1:1/w.ffm");
  ASSERT_FALSE(refused);
  expectSays(refused.error(), "put it into ~/.netrc");
  EXPECT_EQ(refused.error().line().find("secret"), std::string::npos) << refused.error().line();
}

TEST_F(Http, IsReadAndNeverWritten) {
  EXPECT_NE(storageFor(address()), posixStorage());
  EXPECT_EQ(storageFor("out/w.ffm"), posixStorage());
  EXPECT_EQ(storageFor(address()), storageFor("https://127.0.0.1/x.ffm"));
  for (const Error& error : {storage_->create(address()).error(), storage_->remove(address()).error(), storage_->rename("a", address()).error(), storage_->claim(address()).error(),
                             storage_->list(address("/")).error(), storage_->checkWritable(address("/")).error(), storage_->syncFolder(address("/")).error()})
    expectSays(error, "what lies behind a web server is only read");
  EXPECT_EQ(server_.requests, 0u);
}

// A cache over a storage in memory that counts.
class Cache : public testing::Test {
 protected:
  static constexpr const char* kPath = "far/w.0123456789abcdef.ffs";
  Cache() {
    EXPECT_TRUE(writeWholeFile(*memory_, kPath, std::as_bytes(std::span(content_))));
    EXPECT_TRUE(writeWholeFile(*memory_, "far/w.ffm", std::as_bytes(std::span(content_))));
    far_->on_read = [this] { ++reads_; };
  }
  CacheSettings settings(uint64_t limit_bytes = 1 << 30) const { return {.folder = folder_.file("cache"), .limit_bytes = limit_bytes}; }
  // As another process would.
  std::unique_ptr<StoredFile> open(const StoragePtr& storage) {
    auto file = storage->open(kPath);
    EXPECT_TRUE(file) << file.error().line();
    return std::move(*file);
  }
  std::unique_ptr<StoredFile> open() { return open(cachedStorage(far_, settings())); }
  void expectWhole(const StoredFile& file) {
    const auto read = readText(file, 0, content_.size());
    ASSERT_TRUE(read) << read.error().line();
    EXPECT_TRUE(*read == content_);
  }
  std::string inCache() const {
    for (const auto& entry : std::filesystem::directory_iterator(folder_.file("cache"))) return entry.path();
    return "";
  }
  uint64_t cachedBytes() const {
    uint64_t bytes = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder_.file("cache"))) bytes += entry.file_size();
    return bytes;
  }

  const std::string content_ = noise(10 * kCachePiece + 1000);
  TemporaryFolder folder_;
  std::shared_ptr<MemoryStorage> memory_ = std::make_shared<MemoryStorage>();
  std::shared_ptr<FaultyStorage> far_ = std::make_shared<FaultyStorage>(memory_);
  std::atomic<uint64_t> reads_ = 0;  // of far_
};

TEST_F(Cache, AsksForEachPieceOnceAndLaterForNone) {
  const auto file = open();
  EXPECT_EQ(*readText(*file, kCachePiece + 5, 10), content_.substr(kCachePiece + 5, 10));
  EXPECT_EQ(reads_, 1u);
  EXPECT_EQ(*readText(*file, 2 * kCachePiece - 10, 10), content_.substr(2 * kCachePiece - 10, 10));
  EXPECT_EQ(reads_, 1u) << "in the same piece";
  EXPECT_EQ(*readText(*file, 3 * kCachePiece - 5, 2 * kCachePiece), content_.substr(3 * kCachePiece - 5, 2 * kCachePiece));
  EXPECT_EQ(reads_, 2u) << "three pieces together";
  expectWhole(*file);
  EXPECT_EQ(reads_, 4u) << "one before those that are here, one run after them";
  const uint64_t calls = far_->calls;
  expectWhole(*open());
  EXPECT_EQ(far_->calls, calls) << "not even opened";
}

TEST_F(Cache, ManyThreadsOfTwoProcessesReadAPieceOnceEach) {
  const std::unique_ptr<StoredFile> files[] = {open(), open()};
  far_->on_read = [this] {
    ++reads_;
    std::this_thread::sleep_for(2ms);
  };
  std::vector<std::thread> threads;
  for (unsigned k = 0; k < 12; ++k)
    threads.emplace_back([&, k] {
      std::mt19937 random(k);
      for (int i = 0; i < 200; ++i) {
        const size_t bytes = 1 + random() % 100000, offset = random() % (content_.size() - bytes);
        EXPECT_TRUE(*readText(*files[k % 2], offset, bytes) == content_.substr(offset, bytes));
      }
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_LE(reads_, 2 * 11u);
}

TEST_F(Cache, KeepsPiecesInMemoryWhereThereIsNoFolder) {
  const auto storage = cachedStorage(far_, {.folder = "", .memory_bytes = 5 * kCachePiece});
  const auto file = open(storage);
  const auto expectReads = [&](uint64_t piece, uint64_t reads) {
    reads_ = 0;
    EXPECT_EQ(*readText(*file, piece * kCachePiece + 7, 100), content_.substr(piece * kCachePiece + 7, 100));
    EXPECT_EQ(reads_, reads) << "piece " << piece;
  };
  expectReads(1, 1);
  expectReads(1, 0);
  for (uint64_t piece = 2; piece < 6; ++piece) expectReads(piece, 1);
  expectReads(1, 0);
  expectReads(6, 1);
  expectReads(2, 1);  // that was read longest ago
  expectReads(1, 0);
  reads_ = 0;
  EXPECT_EQ(*readText(*open(storage), 6 * kCachePiece, 9), content_.substr(6 * kCachePiece, 9));
  EXPECT_EQ(reads_, 0u) << "opened again";
  file->forget(6 * kCachePiece + 100, 1);
  expectReads(6, 1);
  file->forget(0, file->bytes());
  expectReads(6, 1);
  expectWhole(*file);
}

TEST(PieceMemory, StaysWithinItsLimit) {
  PieceMemory memory(10'000);
  std::mt19937 random(3);
  for (int i = 0; i < 3000; ++i) {
    const PieceMemory::Key key{random() % 3, random() % 20};
    const std::vector<std::byte> bytes(random() % 3000, std::byte{static_cast<unsigned char>(key.piece)});
    memory.keep(key, bytes);
    EXPECT_LE(memory.bytes(), 10'000u);
    ASSERT_TRUE(memory.find(key));
    EXPECT_EQ(*memory.find(key), bytes);
  }
  EXPECT_GT(memory.bytes(), 6'000u);
  memory.keep({1, 1}, std::vector<std::byte>(10'001));
  EXPECT_EQ(memory.bytes(), 0u) << "what is larger than the limit takes the place of all and goes";
}

// With a folder, and in memory.
class Bring : public Cache, public testing::WithParamInterface<bool> {
 protected:
  Bring() {
    far_->on_read = [this] {
      ++reads_;
      for (uint64_t now = ++at_a_time_, most = most_; now > most && !most_.compare_exchange_weak(most, now);) {
      }
      std::this_thread::sleep_for(50ms);
      --at_a_time_;
    };
  }
  StoragePtr storage() const { return cachedStorage(far_, GetParam() ? settings() : CacheSettings{.folder = ""}); }
  std::atomic<uint64_t> at_a_time_ = 0, most_ = 0;
};
INSTANTIATE_TEST_SUITE_P(FolderAndMemory, Bring, testing::Bool());

TEST_P(Bring, AsksForAllAtOnceAndForWhatIsHereNotAgain) {
  const auto file = open(storage());
  (void)readText(*file, 5 * kCachePiece, 1);
  reads_ = 0;
  file->bring(std::vector<StoredFile::Range>{{9 * kCachePiece, 1}, {100, 1}, {2 * kCachePiece, 3 * kCachePiece + 1}, {7 * kCachePiece, 10}, {9 * kCachePiece, 50}, {content_.size() - 1, 1}}, {});
  EXPECT_EQ(reads_, 4u) << "0; 2 to 4, beside 5, which is here; 7; 9 and the last";
  EXPECT_GE(most_, 3u);
  reads_ = 0;
  for (const uint64_t piece : {0, 2, 3, 4, 5, 7, 9, 10}) EXPECT_EQ(*readText(*file, piece * kCachePiece, 100), content_.substr(piece * kCachePiece, 100));
  EXPECT_EQ(reads_, 0u);
}

TEST_P(Bring, LeavesFaultsToTheReads) {
  const auto file = open(storage());
  far_->outage = true;
  const StoredFile::Range ranges[] = {{0, 1}, {5 * kCachePiece, 1}};
  file->bring(ranges, {});
  EXPECT_FALSE(readText(*file, 0, 10));
  far_->outage = false;
  EXPECT_EQ(*readText(*file, 0, 10), content_.substr(0, 10));
  std::atomic<bool> cancelled = true;
  reads_ = 0;
  file->bring(ranges, {.cancelled = &cancelled});
  EXPECT_EQ(reads_, 0u);
  expectWhole(*file);
}

TEST_P(Bring, ManyThreadsBringAndReadAPieceOnceEach) {
  const auto file = open(storage());
  std::vector<std::thread> threads;
  for (unsigned k = 0; k < 8; ++k)
    threads.emplace_back([&, k] {
      std::mt19937 random(k);
      for (int i = 0; i < 50; ++i) {
        const size_t bytes = 1 + random() % 100000, offset = random() % (content_.size() - bytes);
        const StoredFile::Range ranges[] = {{offset, bytes}, {random() % content_.size(), 1}};
        if (i % 2) file->bring(ranges, {});
        EXPECT_TRUE(*readText(*file, offset, bytes) == content_.substr(offset, bytes));
      }
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_LE(reads_, 11u);
}

TEST_P(Bring, WhatIsReadFromItsBeginningToItsEndComesAhead) {
  const auto file = open(storage());
  file->expectAll();
  for (size_t offset = 0; offset < content_.size(); offset += 1000)
    EXPECT_EQ(*readText(*file, offset, std::min<size_t>(1000, content_.size() - offset)), content_.substr(offset, 1000));
  EXPECT_EQ(reads_, 4u) << "the first piece, and the ten behind it by three requests at once";
  EXPECT_EQ(most_, 3u);
}

TEST_F(Cache, ReadsAgainWhatIsDamaged) {
  expectWhole(*open());
  const auto damage = [&](size_t at, size_t bytes) {
    std::vector<std::byte> kept = readFile(inCache());
    for (size_t i = at; i < at + bytes; ++i) kept[i] ^= std::byte{1};
    writeFile(inCache(), kept);
    reads_ = 0;
  };
  const size_t pieces = 4096, slot = kCachePiece + 8;
  damage(pieces + 3 * slot + 100, 1);  // in a piece
  expectWhole(*open());
  EXPECT_EQ(reads_, 1u);
  damage(pieces + 3 * slot + 2, 1);  // in a checksum
  expectWhole(*open());
  EXPECT_EQ(reads_, 1u);
  for (const size_t at : {size_t{9}, size_t{17}, size_t{30}, size_t{4000}}) {  // in the header
    damage(at, 1);
    expectWhole(*open());
    EXPECT_GT(reads_, 0u);
  }
  for (const size_t left : {size_t{0}, size_t{100}, pieces, pieces + slot / 2, pieces + 5 * slot}) {
    const auto file = open();
    std::filesystem::resize_file(inCache(), left);  // by another process
    expectWhole(*file);
    expectWhole(*open());
  }
  reads_ = 0;
  expectWhole(*open());
  EXPECT_EQ(reads_, 0u);
}

TEST_F(Cache, ForgetsWhatItIsToldToForget) {
  const auto file = open();
  expectWhole(*file);
  reads_ = 0;
  file->forget(kCachePiece - 1, 2);
  expectWhole(*file);
  EXPECT_EQ(reads_, 1u) << "two pieces together";
  file->forget(0, file->bytes());
  expectWhole(*file);
  EXPECT_EQ(reads_, 2u);
}

TEST_F(Cache, KeepsNoFilesWhoseNamesDoNotTellTheirContent) {
  const auto storage = cachedStorage(far_, settings());
  for (int i = 0; i < 2; ++i) EXPECT_EQ(readWholeFile(*storage, "far/w.ffm")->size(), content_.size());
  EXPECT_EQ(reads_, 2u);
  ASSERT_TRUE(writeWholeFile(*memory_, "far/w.ffm", std::as_bytes(std::span("new"))));
  EXPECT_EQ(readWholeFile(*storage, "far/w.ffm")->size(), 4u);
}

TEST_F(Cache, StaysWithinItsLimit) {
  const uint64_t limit = 30 * kCachePiece;
  for (int k = 0; k < 9; ++k) {
    const std::string path = "far/w.000000000000000" + std::to_string(k) + ".ffs";
    ASSERT_TRUE(writeWholeFile(*memory_, path, std::as_bytes(std::span(content_))));
    const auto storage = cachedStorage(far_, settings(limit));
    auto file = storage->open(path);
    ASSERT_TRUE(file);
    expectWhole(**file);
    EXPECT_LE(cachedBytes(), limit + limit / 16 + 2 * kCachePiece) << k;
    reads_ = 0;
    expectWhole(**storage->open(path));
    EXPECT_EQ(reads_, 0u) << "what was read last is there";
    EXPECT_EQ(storage->warning(), "");
  }
  EXPECT_GT(cachedBytes(), limit / 2);
}

TEST_F(Cache, IsTurnedOffWithOneWarningWhereItCannotBeWritten) {
  writeFile(folder_.file("cache"), {});  // no folder
  const auto storage = cachedStorage(far_, settings());
  expectWhole(*open(storage));
  EXPECT_NE(storage->warning().find(folder_.file("cache")), std::string::npos) << storage->warning();
  EXPECT_NE(storage->warning().find("FORMFIELD_CACHE"), std::string::npos) << storage->warning();
  EXPECT_EQ(cachedStorage(far_, {.folder = ""})->warning(), "");
  expectWhole(*open(cachedStorage(far_, {.folder = ""})));
}

TEST_F(Cache, IsTurnedOffWhereTheDiskIsFull) {
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{5 * kCachePiece, before.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &small), 0);
  const auto storage = cachedStorage(far_, settings());
  const auto file = open(storage);
  expectWhole(*file);
  const std::string warning = storage->warning();
  const uint64_t reads = reads_;
  EXPECT_EQ(*readText(*file, kCachePiece, 10), content_.substr(kCachePiece, 10));
  EXPECT_EQ(::setrlimit(RLIMIT_FSIZE, &before), 0);
  std::signal(SIGXFSZ, handler);
  EXPECT_NE(warning.find("no longer kept"), std::string::npos) << warning;
  EXPECT_EQ(reads_, reads + 1);
  expectWhole(*open());
}

TEST_F(Cache, APieceThatOthersReadCanBeWaitedForNoLonger) {
  const auto file = open();
  std::atomic<bool> go = false;
  far_->on_read = [&] { go.wait(false); };
  std::thread slow([&] { EXPECT_TRUE(readText(*file, 0, 10)); });
  std::this_thread::sleep_for(20ms);
  const auto late = readText(*file, 5, 10, {.deadline = Clock::now() + 50ms});
  EXPECT_FALSE(late);
  go = true;
  go.notify_all();
  slow.join();
}

TEST(CacheSettings, AreThoseOfTheEnvironment) {
  ::setenv("FORMFIELD_CACHE", "/a/folder", 1);
  ::setenv("FORMFIELD_CACHE_LIMIT", "100", 1);
  EXPECT_EQ(cacheSettings().folder, "/a/folder");
  EXPECT_EQ(cacheSettings().limit_bytes, 100u << 20);
  ::setenv("FORMFIELD_CACHE", "off", 1);
  EXPECT_EQ(cacheSettings().folder, "");
  ::unsetenv("FORMFIELD_CACHE");
  ::setenv("XDG_CACHE_HOME", "/caches", 1);
  EXPECT_EQ(cacheSettings().folder, "/caches/formfield");
  ::unsetenv("XDG_CACHE_HOME");
  ::setenv("HOME", "/home/me", 1);
  EXPECT_EQ(cacheSettings().folder, "/home/me/.cache/formfield");
  ::setenv("FORMFIELD_CACHE_LIMIT", "much", 1);
  const auto storage = cachedStorage(std::make_shared<MemoryStorage>(), cacheSettings());
  EXPECT_NE(storage->warning().find("\"much\" is not a number of MiB"), std::string::npos) << storage->warning();
  ::unsetenv("FORMFIELD_CACHE_LIMIT");
}

// Worlds behind Debian's nginx.
class OverNginx : public testing::Test {
 protected:
  OverNginx() { EXPECT_TRUE(writeWorld(makeRandomWorld({.level0_tiles = 12}), folder_.file("my town.ffm"), 20000)); }
  // Everything of a world; empty: something could not be read.
  static std::vector<std::byte> everything(const std::string& path, const StoragePtr& storage) {
    const auto world = WholeWorld::open(path, storage);
    EXPECT_TRUE(world) << world.error().line();
    if (!world) return {};
    std::vector<std::byte> all;
    for (uint32_t level = 0; level < world->levels().size(); ++level)
      for (const TileInfo& tile : world->tiles(level)) {
        std::vector<std::byte> stored(tile.strip.stored_bytes);
        const auto read = world->readStored(tile.strip, stored);
        const auto strip = world->strip(tile.id);
        EXPECT_TRUE(read && strip);
        all.insert(all.end(), stored.begin(), stored.end());
      }
    return all;
  }
  uint64_t bytesOfWorld() const {
    uint64_t bytes = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder_.path())) bytes += entry.file_size();
    return bytes;
  }
  StoragePtr cached() const { return cachedStorage(httpStorage(), {.folder = cache_.file("cache")}); }
  static uint64_t bytesOf(const std::vector<Nginx::Served>& served) {
    uint64_t bytes = 0;
    for (const Nginx::Served& one : served) bytes += one.body_bytes;
    return bytes;
  }

  TemporaryFolder folder_, cache_;
};

TEST_F(OverNginx, AWorldIsReadWithAFewRequestsAndTheSecondTimeWithOne) {
  // Compression for whoever accepts it.
  const auto nginx = Nginx::start(folder_.path(), "gzip on; gzip_types *; gzip_min_length 1;");
  if (!nginx) GTEST_SKIP();
  const auto expected = everything(folder_.file("my town.ffm"), posixStorage());
  ASSERT_FALSE(expected.empty());
  EXPECT_TRUE(everything(nginx->address("my town.ffm"), cached()) == expected);
  const auto files = static_cast<size_t>(std::distance(std::filesystem::directory_iterator(folder_.path()), {}));
  const auto served = nginx->served(files);  // the geometry, too: its log line may come last
  EXPECT_LE(served.size(), files) << "each is smaller than a piece";
  EXPECT_LE(bytesOf(served), bytesOfWorld());
  for (const Nginx::Served& one : served) EXPECT_EQ(one.status, 206) << one.path;
  EXPECT_TRUE(everything(nginx->address("my town.ffm"), cached()) == expected);
  const auto after = nginx->served(served.size() + 1);
  ASSERT_EQ(after.size(), served.size() + 1);
  EXPECT_EQ(after.back().path, "/my%20town.ffm");
}

TEST_F(OverNginx, AWorldIsReadWithoutRangesAndWithoutACache) {
  const auto nginx = Nginx::start(folder_.path(), "max_ranges 0;");
  if (!nginx) GTEST_SKIP();
  EXPECT_TRUE(everything(nginx->address("my town.ffm"), httpStorage()) == everything(folder_.file("my town.ffm"), posixStorage()));
  for (const Nginx::Served& one : nginx->served(2)) EXPECT_EQ(one.status, 200) << one.path;
}

TEST_F(OverNginx, ARestartOfTheServerIsNotSeenAndANewBakeIsAnError) {
  const auto nginx = Nginx::start(folder_.path());
  if (!nginx) GTEST_SKIP();
  const auto storage = httpStorage();
  auto file = storage->open(nginx->address("my town.ffm"));
  ASSERT_TRUE(file) << file.error().line();
  const size_t bytes = (*file)->bytes();
  (void)readText(**file, 0, 1);
  for (int i = 0; i < 3; ++i) {
    const auto read = readText(**file, 0, bytes);
    ASSERT_TRUE(read) << read.error().line();
    EXPECT_TRUE(*read == textOf(readFile(folder_.file("my town.ffm"))));
    ASSERT_TRUE(nginx->restart());
  }
  ASSERT_TRUE(writeWorld(makeRandomWorld({.level0_tiles = 3}), folder_.file("my town.ffm"), 20000));
  const auto changed = readText(**file, 0, bytes);
  ASSERT_FALSE(changed);
  EXPECT_NE(changed.error().line().find("has changed on the server"), std::string::npos) << changed.error().line();
}

TEST_F(OverNginx, WhetherAFileHasChangedIsAskedWithoutAByteOfIt) {
  for (const char* server : {"", "etag off;"}) {
    const auto nginx = Nginx::start(folder_.path(), server);
    if (!nginx) GTEST_SKIP();
    const auto storage = httpStorage();
    const auto ask = [&] {
      auto version = storage->version(nginx->address("my town.ffm"));
      EXPECT_TRUE(version) << version.error().line();
      return version ? *version : "";
    };
    const std::string first = ask();
    EXPECT_EQ(ask(), first);
    EXPECT_EQ(ask(), first);
    static uint32_t tiles = 3;
    ASSERT_TRUE(writeWorld(makeRandomWorld({.level0_tiles = ++tiles}), folder_.file("my town.ffm"), 20000));
    const std::string second = ask();
    EXPECT_NE(second, first);
    EXPECT_EQ(ask(), second);
    std::vector<int> statuses;
    uint64_t bytes = 0;
    for (const Nginx::Served& one : nginx->served(5)) {
      statuses.push_back(one.status);
      bytes += one.body_bytes;
    }
    const bool tagged = !*server;  // by the time alone a file of another size may be taken for the same
    EXPECT_EQ(statuses, tagged ? (std::vector<int>{206, 304, 304, 206, 304}) : std::vector<int>(5, 206));
    EXPECT_EQ(bytes, tagged ? 2u : 5u);
  }
}

TEST_F(OverNginx, HttpsIsReadWhereTheAuthorityIsKnown) {
  const auto nginx = Nginx::start(folder_.path(), "", true);
  if (!nginx) GTEST_SKIP();
  const auto stranger = httpStorage()->open(nginx->address("my town.ffm"));
  ASSERT_FALSE(stranger);
  EXPECT_NE(stranger.error().line().find("CURL_CA_BUNDLE"), std::string::npos) << stranger.error().line();
  ::setenv("CURL_CA_BUNDLE", nginx->certificate().c_str(), 1);
  EXPECT_TRUE(everything(nginx->address("my town.ffm"), cached()) == everything(folder_.file("my town.ffm"), posixStorage()));
  ::unsetenv("CURL_CA_BUNDLE");
}

// A proxy that spoils a strip once.
TEST(RemoteWorld, BytesThatWereSpoiledOnTheWayAreNotKept) {
  const TemporaryFolder folder, cache;
  ASSERT_TRUE(writeWorld(makeRandomWorld({.level0_tiles = 3}), folder.file("w.ffm"), 1 << 20));
  WebServer server;
  server.addFolder(folder.path());
  const auto world = World::open(server.address("/w.ffm"), cachedStorage(httpStorage(), {.folder = cache.file("cache")}));
  ASSERT_TRUE(world) << world.error().line();
  std::atomic<int> spoiled = 0;
  server.spoil = [&](const WebServer::Request& request, WebServer::Reply& reply) {
    if (request.path.find("index") == std::string::npos && request.path.find(".ffs") != std::string::npos && spoiled++ == 0) reply.body.back() ^= 1;
  };
  const auto tiles = world->levels()[0].tiles;
  bool failed = false;
  for (int round = 0; round < 2; ++round)
    for (uint32_t tile = 0; tile < tiles; ++tile) {
      const auto strip = world->strip(TileId{0, tile});
      failed = failed || !strip;
      if (round == 1) {
        EXPECT_TRUE(strip) << strip.error().line();
      }
    }
  EXPECT_TRUE(failed) << "the test spoils what is read";
}

}  // namespace
}  // namespace ff::formats
