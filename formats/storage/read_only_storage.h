// A storage that is read and never written: every other call is refused in one line.
#pragma once
#include "formats/storage/storage.h"

namespace ff::formats {

class ReadOnlyStorage : public Storage {
 public:
  Result<std::unique_ptr<NewFile>> create(const std::string& path) final { return refused(path); }
  Result<void> rename(const std::string&, const std::string& to) final { return refused(to); }
  Result<void> remove(const std::string& path) final { return refused(path); }
  Result<bool> syncFolder(const std::string& folder) final { return refused(folder); }
  Result<std::vector<std::string>> list(const std::string& folder) final { return refused(folder); }
  Result<std::unique_ptr<Claim>> claim(const std::string& path) final { return refused(path); }
  Result<void> checkWritable(const std::string& folder) final { return refused(folder); }

 private:
  static Error refused(const std::string& path) {
    return {ErrorCode::kIo, path, "", "what lies behind a web server is only read", "write to a folder, and copy that to the server"};
  }
};

}  // namespace ff::formats
