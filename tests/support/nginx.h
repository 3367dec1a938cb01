// Debian's nginx, serving a folder on 127.0.0.1 while it lives.
#pragma once
#include <sys/types.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace ff::formats {

class Nginx {
 public:
  struct Served {
    int status = 0;
    uint64_t body_bytes = 0;
    std::string path;
  };
  // server: more lines of the configuration, of the server. https: with a certificate for 127.0.0.1 that openssl makes, certificate().
  // Null: there is no nginx (or openssl) here, which is said aloud, or it does not start.
  static std::unique_ptr<Nginx> start(const std::string& folder, const std::string& server = "", bool https = false);
  ~Nginx();
  Nginx(const Nginx&) = delete;

  std::string address(const std::string& name) const;
  std::string certificate() const { return own_ + "/certificate.pem"; }
  // What it has served so far: waits until there are `requests` of them.
  std::vector<Served> served(size_t requests) const;
  // As if the machine were switched off and on again: connections break.
  bool restart();

 private:
  Nginx() = default;
  bool launch();
  void stop();
  std::string own_;  // folder of its configuration and logs
  uint16_t port_ = 0;
  bool https_ = false;
  pid_t process_ = -1;
};

}  // namespace ff::formats
