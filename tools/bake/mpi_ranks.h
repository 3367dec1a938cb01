// The processes of one `mpirun ffbake ...`.
#pragma once
#include <memory>

#include "bake/plan/ranks.h"
#include "formats/result.h"

namespace ff::tools {

class MpiRanks : public bake::Ranks {
 public:
  // Null where this process was not started by mpirun or srun, or by itself. Errors (kUsage): it was, and ffbake was built without MPI.
  // To be called before any thread is made but those that handle signals.
  static Result<std::unique_ptr<MpiRanks>> join();
  // The last call, on all ranks; the others wait for rank 0. code: of this process. Rank 0 waits a moment for those who are still casting; where its own
  // code is not 0, or somebody is gone, it ends all processes with that code, and does not return.
  virtual void leave(int code) = 0;
};

}  // namespace ff::tools
