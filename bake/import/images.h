// The pictures of a document: each is read once, however many images, textures and materials name it. Private to
// this folder.
#pragma once
#include <array>
#include <map>
#include <optional>
#include <set>
#include <string>

#include "bake/import/elements.h"
#include "bake/scene.h"

namespace ff::bake::gltf {

class Pictures {
 public:
  Pictures(const Document& document, Scene& scene, Budget& budget, uint64_t max_decoded_bytes)
      : document_(document), scene_(scene), budget_(budget), decodable_(max_decoded_bytes) {}

  // Number in Scene::images of a texture's picture: of the first of its images that can be read. What is missing, broken,
  // too large or of another format is a warning, said once a picture, and kNone is returned.
  uint32_t number(int texture);
  // Means of a texture's channels over the whole picture: `linear` decodes sRGB first; nothing where number() is kNone.
  struct Means {
    std::array<float, 4> stored{}, linear{};  // 0..1; alpha is the same in both
  };
  std::optional<Means> means(int texture);

 private:
  using Key = std::array<uint64_t, 2>;  // of a picture's bytes
  struct Source {
    Key key{};
    Bytes bytes;
    std::vector<uint8_t> owned;
    std::string place;
  };
  Source open(uint32_t image);
  Image decode(const Source& source);
  // What is known, or what make(source) makes, of the first image of a texture that can be read.
  template <class Value, class Make>
  std::optional<Value> firstOf(int texture, std::map<Key, Value>& known, const Make& make);

  const Document& document_;
  Scene& scene_;
  Budget& budget_;
  uint64_t decodable_;  // bytes of pixels that may still be decoded, whether they are kept or not
  std::map<Key, uint32_t> numbers_;
  std::map<Key, Means> means_;
  std::map<Key, Error> faults_;  // of pictures that cannot be read
  std::map<uint32_t, Key> keys_;  // of images that have been opened
  std::set<Key> said_;            // what has been warned of
};

}  // namespace ff::bake::gltf
