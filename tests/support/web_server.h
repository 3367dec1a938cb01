// A web server in this process that serves bytes by ranges, and misbehaves as a test wants. On 127.0.0.1, at a port that was free.
#pragma once
#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <list>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace ff::formats {

class WebServer {
 public:
  struct Request {
    std::string path, headers;      // headers: all lines, as they came
    uint64_t first = 0, end = 0;    // the range; end == 0: none
  };
  struct Reply {
    int status = 404;
    std::string headers, body;      // headers: of lines that end in \r\n, but for Content-Length
    std::string length;             // of the body, as the server says; empty: none
    size_t cut = std::string::npos; // bytes after which the connection is closed, headers among them
    std::chrono::milliseconds delay{};
  };
  std::map<std::string, std::string> files{};               // by path; filled before there are requests
  // Looks at each reply, and may change it; from many threads. May be set at any time: replies under way still know the one before.
  class Spoil {
   public:
    using Function = std::function<void(const Request&, Reply&)>;
    Spoil& operator=(Function function) {
      const std::lock_guard lock(mutex_);
      function_ = std::move(function);
      return *this;
    }
    Function get() const {
      const std::lock_guard lock(mutex_);
      return function_;
    }

   private:
    mutable std::mutex mutex_;
    Function function_;
  } spoil{};
  std::atomic<uint64_t> requests = 0, connections = 0, body_bytes = 0, at_a_time = 0, most_at_a_time = 0;

  WebServer() {
    listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in at{};
    at.sin_family = AF_INET;
    at.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof at;
    if (::bind(listener_, reinterpret_cast<sockaddr*>(&at), size) != 0 || ::listen(listener_, 64) != 0) std::abort();
    ::getsockname(listener_, reinterpret_cast<sockaddr*>(&at), &size);
    port_ = ntohs(at.sin_port);
    accepting_ = std::thread([this] { accept(); });
  }
  ~WebServer() {
    stop_ = true;
    ::shutdown(listener_, SHUT_RDWR);
    accepting_.join();
    for (Session& session : sessions_) ::shutdown(session.socket, SHUT_RDWR);
    for (Session& session : sessions_) {
      session.thread.join();
      ::close(session.socket);
    }
    ::close(listener_);
  }
  // The files of a folder, by their names.
  void addFolder(const std::string& folder) {
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
      if (!entry.is_regular_file()) continue;
      std::ifstream in(entry.path(), std::ios::binary);
      files["/" + entry.path().filename().string()] = std::string(std::istreambuf_iterator<char>(in), {});
    }
  }
  std::string address(const std::string& path) const { return "http://127.0.0.1:" + std::to_string(port_) + path; }

 private:
  struct Session {
    int socket;
    std::thread thread{};
  };

  void accept() {
    for (int socket; (socket = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC)) >= 0;) {
      ++connections;
      Session& session = sessions_.emplace_back(Session{socket});
      session.thread = std::thread([this, socket] { serve(socket); });
    }
  }
  void serve(int socket) {
    std::string text;
    char buffer[4096];
    for (;;) {
      size_t end = 0;
      while ((end = text.find("\r\n\r\n")) == std::string::npos) {
        const ssize_t n = ::recv(socket, buffer, sizeof buffer, 0);
        if (n <= 0) return;
        text.append(buffer, static_cast<size_t>(n));
      }
      Request request;
      request.headers = text.substr(0, end + 2);
      text.erase(0, end + 4);
      request.path = request.headers.substr(4, request.headers.find(' ', 4) - 4);
      if (const size_t range = request.headers.find("Range: bytes="); range != std::string::npos)
        if (std::sscanf(request.headers.c_str() + range, "Range: bytes=%lu-%lu", &request.first, &request.end) == 2) ++request.end;
      if (!answer(socket, request)) {
        ::shutdown(socket, SHUT_RDWR);
        return;
      }
    }
  }
  bool answer(int socket, const Request& request) {
    ++requests;
    const uint64_t now = ++at_a_time;
    for (uint64_t most = most_at_a_time; now > most && !most_at_a_time.compare_exchange_weak(most, now);) {
    }
    Reply reply;
    if (const auto file = files.find(request.path); file != files.end()) {
      const std::string& all = file->second;
      reply.headers = "ETag: \"1\"\r\n";
      if (request.end > 0 && request.first >= all.size()) {
        reply.status = 416;
        reply.headers += "Content-Range: bytes */" + std::to_string(all.size()) + "\r\n";
      } else {
        const uint64_t end = request.end > 0 ? std::min<uint64_t>(request.end, all.size()) : all.size();
        reply.status = request.end > 0 ? 206 : 200;
        reply.body = all.substr(request.first, end - request.first);
        if (request.end > 0)
          reply.headers += "Content-Range: bytes " + std::to_string(request.first) + "-" + std::to_string(end - 1) + "/" + std::to_string(all.size()) + "\r\n";
      }
    }
    reply.length = std::to_string(reply.body.size());
    if (const Spoil::Function function = spoil.get()) function(request, reply);
    for (const auto until = std::chrono::steady_clock::now() + reply.delay; std::chrono::steady_clock::now() < until && !stop_;)
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    std::string all = "HTTP/1.1 " + std::to_string(reply.status) + " x\r\n" + reply.headers;
    if (!reply.length.empty()) all += "Content-Length: " + reply.length + "\r\n";
    all += "\r\n" + reply.body;
    const bool whole = reply.cut >= all.size();
    all.resize(std::min(all.size(), reply.cut));
    body_bytes += reply.body.size();
    --at_a_time;
    for (size_t sent = 0; sent < all.size();) {
      const ssize_t n = ::send(socket, all.data() + sent, all.size() - sent, MSG_NOSIGNAL);
      if (n <= 0) return false;
      sent += static_cast<size_t>(n);
    }
    return whole && !reply.length.empty();
  }

  int listener_ = -1;
  uint16_t port_ = 0;
  std::atomic<bool> stop_ = false;
  std::list<Session> sessions_;  // the accepting thread's, then the destructor's
  std::thread accepting_;
};

}  // namespace ff::formats
