#include "tools/bake/stop_signals.h"

#include <pthread.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <utility>

namespace ff::tools {
namespace {

constexpr std::chrono::milliseconds kPatience{800};

}  // namespace

StopSignals::StopSignals(std::string name) : name_(std::move(name)) {
  sigemptyset(&signals_);
  for (const int s : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction now {};
    if (::sigaction(s, nullptr, &now) == 0 && now.sa_handler != SIG_IGN) sigaddset(&signals_, s);
  }
  sigaddset(&signals_, SIGUSR2);  // for the destructor
  pthread_sigmask(SIG_BLOCK, &signals_, &before_);
  thread_ = std::thread([this] { listen(); });
}

StopSignals::~StopSignals() {
  {
    const std::lock_guard lock(mutex_);
    over_ = true;
  }
  changed_.notify_all();
  pthread_kill(thread_.native_handle(), SIGUSR2);
  thread_.join();
  pthread_sigmask(SIG_SETMASK, &before_, nullptr);
}

void StopSignals::beginWork(std::string line) {
  const std::lock_guard lock(mutex_);
  working_ = true;
  line_ = std::move(line);
}

int StopSignals::stopped() {
  if (!line_.empty()) std::fprintf(stderr, "%s: %s\n", name_.c_str(), line_.c_str());
  return 128 + signal_;
}

void StopSignals::listen() {
  int signal = 0;
  while (sigwait(&signals_, &signal) == 0) {
    std::unique_lock lock(mutex_);
    if (over_) return;
    if (signal == SIGUSR2) continue;
    signal_ = signal;
    const bool again = stop_.exchange(true);
    if (working_ && !again && changed_.wait_for(lock, kPatience, [this] { return over_; })) return;
    if (isatty(STDERR_FILENO)) std::fputc('\n', stderr);  // a bar may be on the line
    ::_exit(stopped());
  }
}

}  // namespace ff::tools
