#include "tests/support/nginx.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <thread>

namespace ff::formats {
namespace {

const char* program(std::initializer_list<const char*> paths) {
  for (const char* path : paths)
    if (::access(path, X_OK) == 0) return path;
  return nullptr;
}

sockaddr_in atPort(uint16_t port) {
  sockaddr_in at{};
  at.sin_family = AF_INET;
  at.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  at.sin_port = htons(port);
  return at;
}

uint16_t freePort() {
  const int socket = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in at = atPort(0);
  socklen_t size = sizeof at;
  const bool bound = ::bind(socket, reinterpret_cast<sockaddr*>(&at), size) == 0 && ::getsockname(socket, reinterpret_cast<sockaddr*>(&at), &size) == 0;
  ::close(socket);
  return bound ? ntohs(at.sin_port) : 0;
}

bool answers(uint16_t port) {
  const int socket = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const sockaddr_in at = atPort(port);
  const bool connected = ::connect(socket, reinterpret_cast<const sockaddr*>(&at), sizeof at) == 0;
  ::close(socket);
  return connected;
}

}  // namespace

std::unique_ptr<Nginx> Nginx::start(const std::string& folder, const std::string& server, bool https) {
  if (!program({"/usr/sbin/nginx"}) || (https && !program({"/usr/bin/openssl"}))) {
    std::cout << "SKIPPED, since there is no " << (https ? "nginx or openssl" : "nginx") << " here: tools/packages installs it\n";
    return nullptr;
  }
  std::string own = (std::filesystem::temp_directory_path() / "ff_nginx_XXXXXX").string();
  if (!::mkdtemp(own.data())) return nullptr;
  std::unique_ptr<Nginx> nginx(new Nginx);
  nginx->own_ = own;
  nginx->https_ = https;
  const std::string certificate = nginx->certificate(), key = own + "/key.pem";
  if (https && std::system(("openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=127.0.0.1 -addext subjectAltName=IP:127.0.0.1 "
                            "-keyout " + key + " -out " + certificate + " 2>" + own + "/openssl.log").c_str()) != 0)
    return nullptr;
  for (int tries = 0; tries < 5; ++tries) {  // another may take the port
    nginx->port_ = freePort();
    std::ofstream(own + "/nginx.conf") << "daemon off; master_process off; pid " << own << "/pid; error_log " << own << "/error.log;\nevents {}\nhttp {\nlog_format short '$status $body_bytes_sent $request_uri'; access_log " << own
                                       << "/access.log short;\nclient_body_temp_path " << own << "/b; proxy_temp_path " << own << "/p; fastcgi_temp_path " << own << "/f; uwsgi_temp_path " << own << "/u; scgi_temp_path " << own
                                       << "/s;\nserver {\nlisten 127.0.0.1:" << nginx->port_ << (https ? " ssl" : "") << ";\n"
                                       << (https ? "ssl_certificate " + certificate + "; ssl_certificate_key " + key + ";\n" : "") << "root " << folder << ";\n" << server << "\n}\n}\n";
    if (nginx->launch()) return nginx;
  }
  std::cout << "nginx does not start:\n" << std::ifstream(own + "/error.log").rdbuf() << "\n";
  return nullptr;
}

bool Nginx::launch() {
  const std::string configuration = own_ + "/nginx.conf", log = own_ + "/error.log";
  std::string words[] = {"nginx", "-c", configuration, "-e", log, "-p", own_};
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  if (::posix_spawn(&process_, "/usr/sbin/nginx", nullptr, nullptr, arguments.data(), environ) != 0) return false;
  for (int i = 0; i < 1000; ++i) {
    if (answers(port_)) return true;
    int status = 0;
    if (::waitpid(process_, &status, WNOHANG) == process_) {
      process_ = -1;
      return false;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  stop();
  return false;
}

void Nginx::stop() {
  if (process_ < 0) return;
  ::kill(process_, SIGTERM);
  ::waitpid(process_, nullptr, 0);
  process_ = -1;
}

bool Nginx::restart() {
  stop();
  return launch();
}

Nginx::~Nginx() {
  stop();
  std::error_code ignored;
  std::filesystem::remove_all(own_, ignored);
}

std::string Nginx::address(const std::string& name) const { return (https_ ? "https://127.0.0.1:" : "http://127.0.0.1:") + std::to_string(port_) + "/" + name; }

std::vector<Nginx::Served> Nginx::served(size_t requests) const {
  std::vector<Served> all;
  for (int i = 0; i < 500; ++i) {  // a line is written after its answer
    all.clear();
    std::ifstream log(own_ + "/access.log");
    for (Served one; log >> one.status >> one.body_bytes >> one.path;) all.push_back(one);
    if (all.size() >= requests) break;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return all;
}

}  // namespace ff::formats
