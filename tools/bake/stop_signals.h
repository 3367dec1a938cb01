// SIGINT, SIGTERM and SIGHUP as a request to stop: work ends by itself where it can do so soon, and is ended where it cannot. Either way
// there is a line on stderr, and the exit code is 128 and the signal's number.
#pragma once
#include <atomic>
#include <condition_variable>
#include <csignal>
#include <mutex>
#include <string>
#include <thread>

namespace ff::tools {

class StopSignals {
 public:
  // To be made before any other thread is, which would else be sent the signals. Those that are ignored (nohup, &) stay ignored.
  explicit StopSignals(std::string name);
  ~StopSignals();

  // Work that looks at flag() has begun: it gets kPatience to end. line: what is said of it; empty: nothing. Before that there is nothing to end.
  void beginWork(std::string line);
  const std::atomic<bool>* flag() const { return &stop_; }
  // Says the line; the exit code of a program that was stopped.
  int stopped();

 private:
  void listen();

  const std::string name_;
  std::atomic<bool> stop_{false};
  std::atomic<int> signal_{0};
  sigset_t signals_, before_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool working_ = false, over_ = false;
  std::string line_ = "stopped";
  std::thread thread_;
};

}  // namespace ff::tools
