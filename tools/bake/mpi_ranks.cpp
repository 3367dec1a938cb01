#include "tools/bake/mpi_ranks.h"

#include <cstdlib>

#ifdef FF_MPI
#define OMPI_SKIP_MPICXX 1
#include <mpi.h>

#include <atomic>
#include <chrono>
#include <cstdio>
#include <mutex>
#include <set>
#include <thread>
#include <utility>
#include <vector>
#endif

namespace ff::tools {
namespace {

// What starts many processes says so to each in its environment.
int startedTogether() {
  for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_SIZE"})
    if (const char* size = std::getenv(name)) return std::atoi(size);
  return 1;
}

#ifdef FF_MPI

using namespace std::chrono_literals;

// From the others to rank 0: the unit that is done, and whether another is asked for; from rank 0: a unit. From rank 0: kLeave, it is over; kHere, it is there still.
constexpr int kAsk = 1, kUnit = 2, kLeave = 3, kHere = 4;
constexpr uint32_t kFailed = bake::kNoUnit - 1;  // instead of a unit: its rank asks no more
constexpr auto kPoll = 1ms;          // MPI's own waiting takes a core
constexpr auto kLeaveWithin = 5s;   // once all is done: more than a unit of rays takes
constexpr auto kHereEvery = 1s, kGoneAfter = 20s;  // without a word, rank 0 is taken to be gone: no message says so

class OpenMpi final : public MpiRanks {
 public:
  OpenMpi() {
    int provided = 0;
    MPI_Init_thread(nullptr, nullptr, MPI_THREAD_SERIALIZED, &provided);
    MPI_Comm_set_errhandler(MPI_COMM_WORLD, MPI_ERRORS_RETURN);
    MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
    MPI_Comm_size(MPI_COMM_WORLD, &size_);
    if (rank_ != 0) return;
    here_.assign(static_cast<size_t>(size_), MPI_REQUEST_NULL);
    here_thread_ = std::jthread([this](const std::stop_token& stop) { sayHere(stop); });
  }
  ~OpenMpi() override {
    end(here_thread_);
    end(thread_);
  }
  int rank() const override { return rank_; }
  int size() const override { return size_; }

  void serve(std::function<uint32_t()> next, std::function<void(uint32_t)> done) override {
    next_ = std::move(next);
    done_ = std::move(done);
    thread_ = std::jthread([this](const std::stop_token& stop) {
      while (!stop.stop_requested())
        if (!answerOne()) std::this_thread::sleep_for(kPoll);
    });
  }
  void endUnits() override {
    const std::lock_guard lock(serving_);
    ended_ = true;
  }

  uint32_t ask(uint32_t done) override {
    const std::lock_guard lock(asking_);  // one question at a time, and none after the last answer
    uint32_t unit = bake::kNoUnit;
    if (ended_ || !send(0, kAsk, done) || !receive(kUnit, unit)) unit = bake::kNoUnit;
    ended_ = unit == bake::kNoUnit;
    return unit;
  }

  void leave(int code) override {
    if (rank_ == 0) {
      endUnits();
      const auto until = std::chrono::steady_clock::now() + kLeaveWithin;
      while (code == 0 && told() < size_ - 1 && std::chrono::steady_clock::now() < until) std::this_thread::sleep_for(kPoll);
      const bool all = told() == size_ - 1;
      end(here_thread_);
      end(thread_);
      if (code != 0 || !all) {
        if (code == 0) std::fprintf(stderr, "ffbake: warning: %d of %d ranks are gone; what they had begun was done again\n", size_ - 1 - told(), size_);
        std::fflush(nullptr);
        MPI_Abort(MPI_COMM_WORLD, code);
        std::_Exit(code);
      }
      for (int r = 1; r < size_; ++r) (void)send(r, kLeave, 0);
    } else {
      if (code != 0) (void)ask(kFailed);
      uint32_t nothing = 0;
      (void)receive(kLeave, nothing);
      if (gone_) {  // MPI would wait for it
        std::fprintf(stderr, "ffbake: rank %d: rank 0 has said nothing for %d s: start the bake again, it goes on from what is in the cache\n", rank_, static_cast<int>(kGoneAfter / 1s));
        std::fflush(nullptr);
        std::_Exit(static_cast<int>(ErrorCode::kIo));
      }
    }
    MPI_Finalize();
  }

 private:
  // Rank 0: whether anybody had asked.
  bool answerOne() {
    int there = 0;
    MPI_Status status;
    uint32_t done = 0;
    {
      const std::lock_guard lock(mpi_);
      if (MPI_Iprobe(MPI_ANY_SOURCE, kAsk, MPI_COMM_WORLD, &there, &status) != MPI_SUCCESS || !there) return false;
      if (MPI_Recv(&done, 1, MPI_UINT32_T, status.MPI_SOURCE, kAsk, MPI_COMM_WORLD, MPI_STATUS_IGNORE) != MPI_SUCCESS) return false;
    }
    uint32_t unit = bake::kNoUnit;
    {
      const std::lock_guard lock(serving_);
      if (!ended_ && done != kFailed) {
        if (done != bake::kNoUnit) done_(done);
        unit = next_();
      }
      if (unit == bake::kNoUnit) told_.insert(status.MPI_SOURCE);
    }
    (void)send(status.MPI_SOURCE, kUnit, unit);
    return true;
  }

  int told() {
    const std::lock_guard lock(serving_);
    return static_cast<int>(told_.size());
  }

  static void end(std::jthread& thread) {
    if (!thread.joinable()) return;
    thread.request_stop();
    thread.join();
  }

  // Rank 0. To a rank that is gone a message may stay under way for ever: it gets no other.
  void sayHere(const std::stop_token& stop) {
    auto next = std::chrono::steady_clock::now();
    for (; !stop.stop_requested(); std::this_thread::sleep_for(10 * kPoll)) {
      if (std::chrono::steady_clock::now() < next) continue;
      next += kHereEvery;
      for (int r = 1; r < size_; ++r) {
        const std::lock_guard lock(mpi_);
        int sent = 0;
        MPI_Request& request = here_[static_cast<size_t>(r)];
        if (MPI_Test(&request, &sent, MPI_STATUS_IGNORE) != MPI_SUCCESS || !sent) continue;
        (void)MPI_Isend(nullptr, 0, MPI_BYTE, r, kHere, MPI_COMM_WORLD, &request);
      }
    }
  }
  // The others: takes what sayHere() has sent; whether there was any.
  static bool isHere() {
    bool any = false;
    for (int there = 0;; any = true) {
      if (MPI_Iprobe(0, kHere, MPI_COMM_WORLD, &there, MPI_STATUS_IGNORE) != MPI_SUCCESS || !there) return any;
      if (MPI_Recv(nullptr, 0, MPI_BYTE, 0, kHere, MPI_COMM_WORLD, MPI_STATUS_IGNORE) != MPI_SUCCESS) return any;
    }
  }

  bool send(int to, int tag, uint32_t value) {
    const std::lock_guard lock(mpi_);
    return MPI_Send(&value, 1, MPI_UINT32_T, to, tag, MPI_COMM_WORLD) == MPI_SUCCESS;
  }
  // The others, from rank 0. False: it is gone.
  bool receive(int tag, uint32_t& value) {
    for (auto heard = std::chrono::steady_clock::now(); !gone_; std::this_thread::sleep_for(kPoll)) {
      const std::lock_guard lock(mpi_);
      if (isHere()) heard = std::chrono::steady_clock::now();
      int there = 0;
      if (MPI_Iprobe(0, tag, MPI_COMM_WORLD, &there, MPI_STATUS_IGNORE) != MPI_SUCCESS) break;
      if (there && MPI_Recv(&value, 1, MPI_UINT32_T, 0, tag, MPI_COMM_WORLD, MPI_STATUS_IGNORE) == MPI_SUCCESS) return true;
      gone_ = std::chrono::steady_clock::now() - heard > kGoneAfter;
    }
    gone_ = true;
    return false;
  }

  int rank_ = 0, size_ = 1;
  std::mutex mpi_;      // one thread at a time is in MPI
  std::mutex asking_, serving_;  // the others', rank 0's: of what follows
  bool ended_ = false;
  std::atomic<bool> gone_ = false;  // rank 0 is
  std::vector<MPI_Request> here_;   // by rank: sayHere()'s last message
  std::set<int> told_;  // ranks that know that there is no more
  std::function<uint32_t()> next_;
  std::function<void(uint32_t)> done_;
  std::jthread thread_, here_thread_;
};

#endif

}  // namespace

Result<std::unique_ptr<MpiRanks>> MpiRanks::join() {
  if (startedTogether() <= 1) return std::unique_ptr<MpiRanks>();
#ifdef FF_MPI
  return std::unique_ptr<MpiRanks>(std::make_unique<OpenMpi>());
#else
  return Error{ErrorCode::kUsage, "mpirun", "", "this ffbake was built without MPI", "install libopenmpi-dev and build it again, or start one process"};
#endif
}

}  // namespace ff::tools
