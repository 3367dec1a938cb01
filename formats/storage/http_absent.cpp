#include "formats/storage/http_storage.h"
#include "formats/storage/read_only_storage.h"

namespace ff::formats {
namespace {

class AbsentHttpStorage final : public ReadOnlyStorage {
 public:
  Result<std::unique_ptr<StoredFile>> open(const std::string& path, const ReadOptions&) override { return absent(path); }
  Result<bool> exists(const std::string& path) override { return absent(path); }
  Result<std::string> version(const std::string& path, const ReadOptions&) override { return absent(path); }

 private:
  static Error absent(const std::string& path) {
    return {ErrorCode::kIo, path, "", "this Formfield was built without libcurl and reads no worlds behind web servers",
            "install libcurl4-openssl-dev, configure with -DFORMFIELD_HTTP=ON and build again"};
  }
};

}  // namespace

StoragePtr httpStorage(const HttpSettings&) { return std::make_shared<AbsentHttpStorage>(); }

}  // namespace ff::formats
